"""How much the Gaussians of a group give to its training views. N Gaussians."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from airgs_codec.analysis.grouping import middle_frame
from airgs_codec.progress import Progress, silent
from airgs_codec.render.backend import Renderer
from airgs_codec.scene.beside import Usage
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.trainer.data.pictures import Pictures
from airgs_codec.trainer.fit.losses import codec_steps
from airgs_codec.trainer.fit.parameters import ATTRIBUTES, Parameters


def group_usage(
    read: Callable[[int], Gaussians],
    pictures: Pictures,
    renderer: Renderer,
    span: tuple[int, int],
    progress: Progress = silent,
) -> Usage:
    """Usage over all frames [start, stop) of a group, which `read` gives, and all its training views.

    Motion is measured against the middle frame, which the codec's differences start from, in codec steps there.
    """
    middle = middle_frame(*span)
    base = read(middle)
    steps = codec_steps(base, [view.camera for view in pictures.train(middle)], renderer=renderer)
    n = len(base)
    total, peak, hits, moved = np.zeros(n), np.zeros(n), np.zeros(n, np.int64), np.zeros(n)
    for done, frame in enumerate(range(*span), 1):
        g = read(frame)
        loaded, seen = renderer.load(g), np.zeros(n)
        for view in pictures.train(frame):
            c = loaded.contribution(view.camera)
            total += c.total
            hits += c.hits
            seen = np.maximum(seen, c.peak)
        peak = np.maximum(peak, seen)
        moved = np.maximum(moved, seen * change_in_steps(base, g, steps))
        progress(f"usage of frames {span[0]} to {span[1] - 1}", done, span[1] - span[0])
    return Usage(total, peak, hits, moved)


def change_in_steps(a: Gaussians, b: Gaussians, steps: Parameters) -> NDArray[np.float64]:
    """(N,) Euclidean length of the change from a to b over all channels, each in codec steps."""
    square = np.zeros(len(a))
    for name in ATTRIBUTES:
        d = (getattr(b, name) - getattr(a, name)) / steps[name].numpy()
        square += np.square(d.astype(np.float64)).reshape(len(a), -1).sum(axis=1)
    return np.sqrt(square)
