"""A crowd of viewers behind one cache."""
