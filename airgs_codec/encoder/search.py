"""Trial encodes of the top rung, until it has a PSNR or a size."""

from __future__ import annotations

import itertools
import tempfile
from dataclasses import replace
from pathlib import Path

from airgs_codec.encoder.encoder import EncodeJob, encode_sequence
from airgs_codec.encoder.quality import measure_quality
from airgs_codec.encoder.rate_target import PSNR, Goal, find_quality
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.package.mpd import write_mpd
from airgs_codec.package.store import Package
from airgs_codec.package.tables import Manifest, pooled_quality
from airgs_codec.progress import Progress
from airgs_codec.scene.sequence import GaussianSequence

TRIAL_FRAMES = 6  # measured in each segment for a PSNR, where the package itself is not measured


def search_quality(
    job: EncodeJob,
    original: GaussianSequence,
    settings: EncodeSettings,
    goal: Goal,
    folder: Path,
    progress: Progress,
) -> float:
    """The quality factor that brings the top rung to its goal. Raises ConfigError for a goal out of reach.

    PSNR is measured against `original`, which has all SH bands. Trials are written into `folder` and removed.
    """
    top = replace(settings, levels=settings.levels[:1], core_levels=0)
    frames = settings.measure_frames or TRIAL_FRAMES
    numbers = itertools.count(1)

    def trial(factor: float) -> float:
        progress(f"trial {next(numbers)}: quality factor {factor:.3g}", 0, 1)
        with tempfile.TemporaryDirectory(prefix=".trial", dir=folder) as name:
            manifest = encode_sequence(job, replace(top, quality=factor), Path(name), progress)
            if goal.kind != PSNR:
                return kilobytes_a_frame(manifest, len(settings.levels))
            package = Package(Path(name), manifest, 0)
            measured = pooled_quality(measure_quality(package, original, job.views.measured, frames, progress), 0, 0)
        assert measured is not None
        return measured.psnr

    return find_quality(goal, trial, settings.quality)


def kilobytes_a_frame(top: Manifest, levels: int) -> float:
    """All that a viewer of the top rung fetches, manifests included, if the package of `top` had so many levels."""
    return (top.bytes_of(top.rung_files(0, 0)) + _manifest_bytes(top, levels)) / top.frames / 1e3


def _manifest_bytes(m: Manifest, levels: int) -> int:
    """Length of both manifests if the package had so many levels, each like the only one in `m`."""
    files = dict(m.files)
    for path, entry in m.files.items():
        files |= {path.replace("/L0/", f"/L{j}/"): entry for j in range(levels)}
    many = replace(
        m,
        levels=m.levels * levels,
        state_pictures=m.state_pictures * levels,
        groups=[replace(g, levels=g.levels * levels) for g in m.groups],
        segments=[replace(s, levels=s.levels * levels) for s in m.segments],
        files=files,
    )
    return len(many.to_json()) + len(write_mpd(many))
