"""Cameras from the files that people have: `colmap` and `forms` know the conventions of forms; `read` takes any."""
