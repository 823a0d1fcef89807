"""Cameras from the files that people have: `colmap` and `forms` know the conventions of each form; `read` takes any of them."""
