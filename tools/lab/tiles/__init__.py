"""A scene in spatial tiles: what it costs to cut it, and what a player saves that fetches by view."""
