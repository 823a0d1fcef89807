"""The sections of the report on error against run time: a module each, whose `measure` is a generator of rows."""
