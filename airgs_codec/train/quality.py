"""How good trained Gaussians are: means over views of the quality of each.

The PSNR of training is the mean over views of each view's PSNR in dB. The PSNR of a package pools the squared error of
its pictures first, and is lower where views differ.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from airgs_codec.media.metrics import Picture, psnr
from airgs_codec.render.backend import CPU, Renderer
from airgs_codec.render.compare import compare, draw_still
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.train.data.pictures import View

PSNR_DEFINITION = "mean over views of the PSNR of each, in dB"


def mean_psnr(g: Gaussians, views: Sequence[View], renderer: Renderer = CPU) -> float:
    """Mean over views of each view's PSNR in dB."""
    return float(np.mean([psnr(error) for error in _compare(g, views, renderer, Picture.mse)]))


def better(before: Gaussians, after: Gaussians, views: Sequence[View], renderer: Renderer = CPU) -> Gaussians:
    """Whichever of two shows more, `after` where they show the same."""
    return before if mean_psnr(before, views, renderer) > mean_psnr(after, views, renderer) else after


def mean_ssim(g: Gaussians, views: Sequence[View], renderer: Renderer = CPU) -> float:
    """Mean over views of each view's SSIM, 1 for equal pictures."""
    return float(np.mean(list(_compare(g, views, renderer, Picture.ssim))))


def _compare(
    g: Gaussians, views: Sequence[View], renderer: Renderer, measure: Callable[[Picture, Picture], float]
) -> Iterator[float]:
    """A figure of each view's picture as it was taken and as the Gaussians are drawn."""
    numbered = [(i, view.camera) for i, view in enumerate(views)]
    return compare(lambda i, _: Picture.of(views[i].target.rgb), draw_still(g, renderer), numbered, measure)
