"""What the suite does in small, done for hours: run as `python -m tests.long`."""
