"""Splats in the file formats that people have, one module a format: frames in `table`, clips in `clips`."""
