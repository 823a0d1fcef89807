"""Multi-view video on disk: readers of the formats people have."""
