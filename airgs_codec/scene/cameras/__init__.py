"""Cameras from the files that people have: one module knows the conventions of one form; `read` takes any of them."""
