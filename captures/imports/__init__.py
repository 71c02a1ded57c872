"""Files of other programs, read as captures by a mapping that says what their arrays are."""
