"""Findings of pictures about a scene: groups, usage, sensitivity, importance."""
