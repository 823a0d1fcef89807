"""What is in a package, and whether it is what it claims to be."""
