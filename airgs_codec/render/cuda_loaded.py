"""Gaussians on a CUDA device as `backend.Loaded` has them: drawn by gsplat, pictures as arrays. N Gaussians."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from airgs_codec.render.cpu import TILE, Contribution, Floats, Render, Weights
from airgs_codec.render.cuda import Drawn, measure_pairs, measure_weights, rasterize, upload
from airgs_codec.render.inputs import RasterInputs
from airgs_codec.scene.camera import Background, Camera


@dataclass(frozen=True, slots=True, eq=False)
class OnCuda:
    """Gaussians for gsplat."""

    inputs: RasterInputs[Floats]
    tensors: RasterInputs[torch.Tensor]  # the same on the device

    @staticmethod
    def of(inputs: RasterInputs[Floats], device: str = "cuda") -> OnCuda:
        """Activated Gaussians, copied to a device."""
        return OnCuda(inputs, RasterInputs(*(upload(column, device) for column in inputs)))

    def draw(self, camera: Camera, background: Background | None = None) -> Render:
        """The picture that `camera` sees before a background; None: the camera's."""
        return _draw(self.tensors, camera, camera.background if background is None else background)

    def contribution(self, camera: Camera) -> Contribution:
        """How much each Gaussian gives to what `camera` sees."""
        if not len(self.inputs.means):
            return _contribution(None)
        with torch.no_grad():
            return _contribution(rasterize(self.tensors, [camera], [camera.background]))

    def contribution_and_gradients(self, camera: Camera, pull: Floats) -> tuple[Contribution, RasterInputs[Floats]]:
        """The contribution, and the derivatives by the activated Gaussians of sum(picture * pull), pull (H, W, 3)."""
        if not len(self.inputs.means):
            return _contribution(None), RasterInputs(*(np.zeros_like(column) for column in self.inputs))
        leaves = RasterInputs(*(t.detach().clone().requires_grad_(True) for t in self.tensors))
        drawn = rasterize(leaves, [camera], [camera.background])
        gradients = torch.autograd.grad((drawn.rgb[0] * upload(pull, drawn.rgb.device)).sum(), leaves)
        return _contribution(drawn), RasterInputs(*(_array(g) for g in gradients))

    def weights(self, camera: Camera, mask: NDArray[np.bool_]) -> Weights:
        """The picture that `camera` sees, and what each Gaussian gives to tiles, in all and in a mask (H, W)."""
        shape = (-(-camera.height // TILE), -(-camera.width // TILE))
        if not len(self.inputs.means):
            none = np.zeros(0, np.int32)
            return Weights(self.draw(camera), shape, none, none, np.zeros(0, np.float32), np.zeros(0, np.float32))
        with torch.no_grad():
            drawn = rasterize(self.tensors, [camera], [camera.background])
            ids, tiles, total, inside = measure_pairs(drawn, upload(mask, drawn.rgb.device))
        picture = Render(_array(drawn.rgb[0]), _array(drawn.transmittance[0]))
        pairs = (_array(ids.int()), _array(tiles.int()), _array(total.float()), _array(inside.float()))
        return Weights(picture, shape, *pairs)

    def without(self, camera: Camera) -> Callable[[NDArray[np.bool_] | None], Floats]:
        """Draws what `camera` sees of the rows of a mask (N,), None for all, as often as it is asked."""

        def draw(kept: NDArray[np.bool_] | None) -> Floats:
            if kept is None:
                return self.draw(camera).rgb
            rows = torch.from_numpy(np.flatnonzero(kept)).to(self.tensors.means.device)
            return _draw(RasterInputs(*(t[rows] for t in self.tensors)), camera, camera.background).rgb

        return draw


def _draw(tensors: RasterInputs[torch.Tensor], camera: Camera, background: Background) -> Render:
    if not len(tensors.means):  # gsplat takes no empty scene
        rgb = np.tile(np.asarray(background, np.float32), (camera.height, camera.width, 1))
        return Render(rgb, np.ones((camera.height, camera.width), np.float32))
    with torch.no_grad():
        drawn = rasterize(tensors, [camera], [background])
    return Render(_array(drawn.rgb[0]), _array(drawn.transmittance[0]))


def _contribution(drawn: Drawn | None) -> Contribution:
    """What one camera saw; None: there was nothing."""
    if drawn is None:
        return Contribution(np.zeros(0), np.zeros(0), np.zeros(0, np.int64))
    total, peak, hits = (values.cpu().numpy() for values in measure_weights(drawn))
    return Contribution(total, peak, hits.astype(np.int64))


def _array(values: torch.Tensor) -> NDArray[Any]:
    return values.detach().cpu().numpy()
