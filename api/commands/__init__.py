"""The commands: each calls one verb and prints its result."""
