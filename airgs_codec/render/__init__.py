"""Rendering Gaussians as cameras see them.

`cpu` draws with numba kernels (`cpu_kernels`) and needs no torch. `differentiable` is the same as a torch function with
gradients; for tensors on a CUDA device it calls gsplat (`cuda`). `reference` is the definition: slow, plain, float64.
"""

from airgs_codec.render.cpu import Contribution, Render, measure_contribution, render
from airgs_codec.scene.camera import Camera, look_at
from airgs_codec.scene.cameras.read import read_cameras

__all__ = [
    "Camera",
    "Contribution",
    "Render",
    "look_at",
    "measure_contribution",
    "read_cameras",
    "render",
]
