"""What a package is: its tables, paths, channel order, MPD and files on disk (FORMAT.md)."""
