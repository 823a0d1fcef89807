"""How good trained Gaussians are: means over views of the quality of each.

The PSNR of training is the mean over views of each view's PSNR in dB. The PSNR of a package pools the squared error of
its pictures first, and is lower where views differ.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from airgs_codec.media.metrics import mse, psnr, ssim
from airgs_codec.render.backend import CPU, Renderer
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.train.data.pictures import View

PSNR_DEFINITION = "mean over views of the PSNR of each, in dB"


def mean_psnr(g: Gaussians, views: Sequence[View], renderer: Renderer = CPU) -> float:
    """Mean over views of each view's PSNR in dB."""
    loaded = renderer.load(g)
    return float(np.mean([psnr(mse(loaded.draw(view.camera).rgb, view.target.rgb)) for view in views]))


def better(before: Gaussians, after: Gaussians, views: Sequence[View], renderer: Renderer = CPU) -> Gaussians:
    """Whichever of two shows more, `after` where they show the same."""
    return before if mean_psnr(before, views, renderer) > mean_psnr(after, views, renderer) else after


def mean_ssim(g: Gaussians, views: Sequence[View], renderer: Renderer = CPU) -> float:
    """Mean over views of each view's SSIM, 1 for equal pictures."""
    loaded = renderer.load(g)
    return float(np.mean([ssim(loaded.draw(view.camera).rgb, view.target.rgb) for view in views]))
