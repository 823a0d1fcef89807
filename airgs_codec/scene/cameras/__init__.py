"""Cameras from the files that people have: `colmap` and `forms` know what each form means; `read` takes any of them."""
