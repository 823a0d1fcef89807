"""Policies: pure functions from what the player knows to a rung with its reason, and the table of their names."""
