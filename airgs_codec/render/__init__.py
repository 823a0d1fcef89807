"""Renderer and cameras; never imports torch (render.autograd does)."""

from airgs_codec.render.camera import Camera, look_at, read_cameras
from airgs_codec.render.cpu import Contribution, Render, measure_contribution, render

__all__ = ["Camera", "Contribution", "Render", "look_at", "measure_contribution", "read_cameras", "render"]
