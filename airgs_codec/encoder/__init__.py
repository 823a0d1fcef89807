"""Sequence -> package."""
