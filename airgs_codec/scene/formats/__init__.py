"""Splats in the file formats that people have: `table` lists them, and finds, reads and writes files of any."""
