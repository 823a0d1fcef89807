"""One choice of what draws: the CPU's kernels, or gsplat on a CUDA device. Numpy arrays go in and come out.

A `Renderer` is made once from the name of a device and handed down to all that draws. N Gaussians, H x W pixels.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

from airgs_codec._arguments import argument
from airgs_codec.errors import ConfigError
from airgs_codec.render.cpu import Loaded, Render, activate
from airgs_codec.scene.camera import Background, Camera, with_near_planes
from airgs_codec.scene.formats.clips import as_gaussians
from airgs_codec.scene.gaussians import Gaussians

DEVICES = ("auto", "cpu", "cuda")


@dataclass(frozen=True, slots=True)
class Renderer:
    device: str = "cpu"  # cpu or cuda

    def load(self, gaussians: Gaussians) -> Loaded:
        active = activate(gaussians)
        if self.device == "cpu" or not len(active.means):  # gsplat takes no empty scene
            return Loaded(active)
        from airgs_codec.render import cuda  # torch is loaded only where it draws

        return cuda.OnCuda.of(active)

    def render(self, gaussians: Gaussians, camera: Camera, background: Background | None = None) -> Render:
        """Draw what `camera` sees of the Gaussians before a background; None: the camera's."""
        return self.load(gaussians).draw(camera, background)


CPU = Renderer()


def open_renderer(device: str) -> Renderer:
    """Return the renderer of auto, cpu or cuda; auto is cuda where gsplat can run. Raises ConfigError."""
    if device not in DEVICES:
        raise ConfigError(f"device: expected {', '.join(DEVICES)}, got {device!r}")
    if device == "cpu":
        return CPU
    reason = _missing()
    if device == "cuda" and reason:
        raise ConfigError(f"device cuda: {reason}")
    return CPU if reason else Renderer("cuda")


def draw(gaussians: Gaussians | Mapping[str, Any], camera: Camera, device: str = "cpu") -> Render:
    """Draw what a camera sees of Gaussians before its background, on cpu or, with gsplat, on cuda.

    They may be a mapping of arrays, as in `Sequence.from_arrays`; `device` may be auto, too. Raises SceneError for what
    is no frame, ConfigError where the device cannot be used.
    """
    renderer, shown = open_renderer(device), as_gaussians(gaussians)
    (seen,) = with_near_planes([argument("camera", camera, Camera, "a Camera")], shown)
    return renderer.render(shown, seen)


def _missing() -> str | None:
    """Why gsplat cannot run here; None if it can. Looks for it before torch is loaded, which takes a second."""
    for library in ("torch", "gsplat"):
        if find_spec(library) is None:
            return f"{library} is not installed: pip install 'airgs-codec[cuda]'"
    from airgs_codec.render import cuda

    return cuda.missing()
