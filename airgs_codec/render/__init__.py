"""Rendering Gaussians as cameras see them.

`cpu` draws with numba kernels (`cpu_kernels`) and needs no torch. `cuda` does so as a torch function with gradients, by
gsplat for tensors on a CUDA device. `reference` is the definition: slow, plain, float64.
"""

from airgs_codec.render.cpu import Contribution, Render, Without, measure_contribution, render
from airgs_codec.scene.camera import Camera, look_at
from airgs_codec.scene.cameras import read_cameras

__all__ = ["Camera", "Contribution", "Render", "Without", "look_at", "measure_contribution", "read_cameras", "render"]
