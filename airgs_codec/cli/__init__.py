"""The commands: parse arguments, call the library once, print."""
