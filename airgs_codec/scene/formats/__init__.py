"""Static splats in the file formats that people have: one module a format, all of them in `table`."""
