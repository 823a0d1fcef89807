"""Multi-view video -> tracked Gaussian sequence (needs torch)."""
