"""Methods, arrays in and arrays out, one package per problem."""
