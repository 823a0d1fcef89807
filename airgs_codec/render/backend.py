"""One choice of what draws: the CPU's kernels, or gsplat on a CUDA device. Numpy arrays go in and come out.

A `Renderer` is made once from the name of a device and handed down to all that draws. N Gaussians, H x W pixels.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from airgs_codec._arguments import argument
from airgs_codec.errors import ConfigError
from airgs_codec.render import cpu
from airgs_codec.render.cpu import Contribution, Floats, RasterInputs, Render, Weights
from airgs_codec.scene.camera import Background, Camera, with_near_planes
from airgs_codec.scene.formats.clips import as_gaussians
from airgs_codec.scene.gaussians import Gaussians

DEVICES = ("auto", "cpu", "cuda")

Without = Callable[[NDArray[np.bool_] | None], Floats]  # mask (N,) of the rows that are drawn, None: all -> (H, W, 3)


class Loaded(Protocol):
    """Gaussians that are ready to be drawn."""

    @property
    def inputs(self) -> RasterInputs[Floats]:
        """The activated Gaussians, as arrays."""

    def draw(self, camera: Camera, background: Background | None = None) -> Render:
        """The picture that `camera` sees before a background; None: the camera's."""

    def contribution(self, camera: Camera) -> Contribution:
        """How much each Gaussian gives to what `camera` sees."""

    def contribution_and_gradients(self, camera: Camera, pull: Floats) -> tuple[Contribution, RasterInputs[Floats]]:
        """The contribution, and the derivatives by the activated Gaussians of sum(picture * pull), pull (H, W, 3)."""

    def weights(self, camera: Camera, mask: NDArray[np.bool_]) -> Weights:
        """The picture that `camera` sees, and what each Gaussian gives to tiles, in all and in a mask (H, W)."""

    def without(self, camera: Camera) -> Without:
        """Draws what `camera` sees of some of the rows, again and again; cheaper than loading them each time."""


@dataclass(frozen=True, slots=True)
class Renderer:
    device: str = "cpu"  # cpu or cuda

    def load(self, gaussians: Gaussians) -> Loaded:
        active = cpu.activate(gaussians)
        if self.device == "cpu":
            return _OnCpu(active)
        from airgs_codec.render import cuda  # torch is loaded only where it draws

        return cuda.OnCuda.of(active)

    def render(self, gaussians: Gaussians, camera: Camera, background: Background | None = None) -> Render:
        """The picture that `camera` sees of the Gaussians before a background; None: the camera's."""
        return self.load(gaussians).draw(camera, background)

    def measure_contribution(self, gaussians: Gaussians, camera: Camera) -> Contribution:
        """How much each Gaussian contributes to what `camera` sees."""
        return self.load(gaussians).contribution(camera)


CPU = Renderer()


def open_renderer(device: str) -> Renderer:
    """The renderer of auto, cpu or cuda; auto is cuda where gsplat can run. Raises ConfigError where cuda cannot."""
    if device not in DEVICES:
        raise ConfigError(f"device: expected {', '.join(DEVICES)}, got {device!r}")
    if device == "cpu":
        return CPU
    reason = _missing()
    if device == "cuda" and reason:
        raise ConfigError(f"device cuda: {reason}")
    return CPU if reason else Renderer("cuda")


def draw(gaussians: Gaussians | Mapping[str, Any], camera: Camera, device: str = "cpu") -> Render:
    """The picture that a camera sees of Gaussians before its background, drawn on cpu or, with gsplat, on cuda.

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


@dataclass(frozen=True, slots=True, eq=False)
class _OnCpu:
    inputs: RasterInputs[Floats]

    def draw(self, camera: Camera, background: Background | None = None) -> Render:
        return cpu.blend(self.inputs, camera, camera.background if background is None else background).picture

    def contribution(self, camera: Camera) -> Contribution:
        return cpu.contribution(self.inputs, camera)

    def contribution_and_gradients(self, camera: Camera, pull: Floats) -> tuple[Contribution, RasterInputs[Floats]]:
        return cpu.contribution_and_gradients(self.inputs, camera, pull)

    def weights(self, camera: Camera, mask: NDArray[np.bool_]) -> Weights:
        return cpu.weights(self.inputs, camera, mask)

    def without(self, camera: Camera) -> Without:
        tiles = cpu.project(self.inputs, camera).tiles
        return lambda drawn: cpu.draw(tiles if drawn is None else tiles.keep(drawn), camera.background).rgb
