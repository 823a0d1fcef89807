"""Which part of a coded scene keeps its pictures from being better: each part in turn is made exact. N rows coded."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec._sampling import evenly_spaced
from airgs_codec.decoder.decode import decode
from airgs_codec.encoder.encoder import Encoded
from airgs_codec.encoder.group_jobs import GroupJobs
from airgs_codec.media.metrics import Picture, psnr
from airgs_codec.render.compare import compare, draw_ahead, draw_still
from airgs_codec.scene.gaussians import Gaussians, join_rows

FRAMES = 6  # of the sequence, each looked at from a view of its own
PARTS = {
    "positions": ("means",),
    "rotations": ("quaternions",),
    "sizes": ("log_scales",),
    "opacities": ("opacity_logits",),
    "colours": ("sh_dc", "sh_rest"),
}
LEFT_OUT = "Gaussians left out"


def find_limit(encoded: Encoded, original: GroupJobs) -> tuple[str, float]:
    """The part of the top rung without whose error pictures gain most, and the PSNR in dB that they would have then.

    The part is a name of PARTS or LEFT_OUT.
    """
    errors: dict[str, list[float]] = {}
    package, renderer = encoded.package(), original.views.renderer
    numbers = evenly_spaced(package.manifest.frames, FRAMES)
    for view in zip(numbers, original.views.measuring, strict=False):
        number, _ = view
        whole = original.sequence.load([number]).frames[0]
        group = next(span.index for span in original.spans if number < span.stop)
        reference = draw_ahead(draw_still(whole, renderer), [view])
        for name, shown in _made_exact(whole, decode(package, number), encoded.group(group).rows):
            found = compare(reference, draw_still(shown, renderer), [view], Picture.mse)
            errors.setdefault(name, []).extend(found)
    means = {name: float(np.mean(found)) for name, found in errors.items()}
    best = min(means, key=lambda name: means[name])
    return best, psnr(means[best])


def _made_exact(whole: Gaussians, shown: Gaussians, rows: NDArray[np.intp]) -> Iterator[tuple[str, Gaussians]]:
    """A decoded frame, N of the original's rows, with each part of it in turn as in the original."""
    exact = whole.take(rows)
    for name, attributes in PARTS.items():
        yield name, replace(shown, **{attribute: getattr(exact, attribute) for attribute in attributes})
    others = whole.with_degree(shown.sh_degree).take(np.setdiff1d(np.arange(len(whole)), rows))
    yield LEFT_OUT, join_rows([shown, others])
