"""Methods on arrays, one package per problem."""
