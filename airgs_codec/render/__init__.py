"""The renderer: numba kernels on the CPU, gsplat on CUDA, a slow reference. Only torch users import torch."""

from airgs_codec.render.cpu import Contribution, Render, measure_contribution, render
from airgs_codec.scene.camera import Camera, look_at, read_cameras

__all__ = ["Camera", "Contribution", "Render", "look_at", "measure_contribution", "read_cameras", "render"]
