"""Types and mechanisms that every other package stands on."""
