"""Training: dynamic scenes from multi-view video."""
