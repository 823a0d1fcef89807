"""What pruning updates costs and saves (the paper's pruning figures), and where the time of a frame goes."""

from __future__ import annotations

import time
from typing import Any

from airgs_codec.decoder.decode import decode_frames
from airgs_codec.decoder.group_states import MEASURED
from airgs_codec.inspect.dense import HOLD, measure_dense, pruning_levels
from airgs_codec.package.store import Package
from airgs_codec.progress import Progress, silent
from airgs_codec.scene.sequence import GaussianSequence
from airgs_codec.train.data.pictures import Pictures
from tools.reproduction.training import Row


def measure_pruning(
    package: Package, original: GaussianSequence, views: Pictures, rate_bps: float, progress: Progress = silent
) -> list[dict[str, Any]]:
    """For each ranking and share pruned, PSNR to the trained Gaussians at held-out cameras, state bytes and time.

    Updates that are pruned are withheld. `rate_bps`: of the link that the milliseconds are for, without overlap.
    """
    m = package.manifest
    held_out, training = ([view.camera for view in some] for some in (views.held_out(0), views.train(0)))
    levels = measure_dense(package, held_out, training, original, progress=progress)
    rows = []
    for ranking in MEASURED:
        for level in pruning_levels(levels, ranking, HOLD):
            size = level.bytes / m.frames
            milliseconds = 8e3 * size / rate_bps
            pruned = level.pruning.pruned
            rows.append({"ranking": ranking, "pruned": pruned, "kb_frame": size / 1e3, "ms": milliseconds})
            rows[-1] |= {"psnr": level.psnr, "ssim": level.ssim}
    return rows


def time_of_frame(package: Package, trained: Row, rate_bps: float) -> dict[str, float]:
    """Milliseconds of a frame in the top rung: over the link at its mean rate, decoding and drawing on one core."""
    m = package.manifest
    for _ in decode_frames(package, 0, min(2, m.frames)):  # compiles
        pass
    begun = time.perf_counter()
    for _ in decode_frames(package, 0, m.frames):
        pass
    decode_ms = 1e3 * (time.perf_counter() - begun) / m.frames
    return {"link": 8e6 * trained.kb_frame / rate_bps, "decode": decode_ms, "draw": 1e3 / trained.fps}
