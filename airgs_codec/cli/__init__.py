"""The commands: parse, one library call, report."""
