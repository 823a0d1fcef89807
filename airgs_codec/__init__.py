"""AirGS codec: dynamic 3D Gaussian Splatting scenes as H.264 pictures, pruning levels and a DASH manifest."""

__version__ = "0.1.0"
