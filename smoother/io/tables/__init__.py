"""Tables as devices write them: layout, columns, units, and a row of a table a format."""
