"""From a sequence to a published package: encode, check, measure, write the manifests last."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from airgs_codec.encode import encode_sequence
from airgs_codec.manifest import JSON_NAME, MPD_NAME, Manifest, Views
from airgs_codec.measure import DEFAULT_FRAMES, measure_quality, measured_views
from airgs_codec.mpd import write_mpd
from airgs_codec.package import Package, staged, write_file
from airgs_codec.render.views import orbit_views
from airgs_codec.sequence import Sequence
from airgs_codec.settings import EncodeSettings


@dataclass(frozen=True, slots=True)
class AuthorReport:
    """What was published and what it took."""

    manifest: Manifest
    manifest_bytes: int
    encode_s: float
    measure_s: float


def author_package(
    sequence: Sequence,
    target: Path,
    settings: EncodeSettings,
    *,
    attribution: str = "",
    measure_frames: int = DEFAULT_FRAMES,
    progress: Callable[[str, int, int], None] = lambda what, done, total: None,
) -> AuthorReport:
    """Publish `sequence` as the package `target`; `measure_frames` 0 leaves quality out.

    Raises the errors of `encode_sequence` and `staged`; then `target` is as it was.
    """
    given = list(sequence.cameras)
    cameras = given or orbit_views(sequence.read(len(sequence) // 2))
    training = [c for c in cameras if c.split != "test"] or cameras
    shown = measured_views(cameras)
    views = Views(
        "given" if given else "generated",
        len(training),
        len(shown),
        shown[0].width,
        shown[0].height,
        "original" if measure_frames else "none",
    )
    with staged(target) as stage:
        began = time.perf_counter()
        manifest = encode_sequence(sequence, training, views, settings, stage, attribution, progress)
        encoded = time.perf_counter()
        if measure_frames:
            manifest = measure_quality(Package(stage, manifest, 0), sequence, shown, measure_frames, progress)
        tables = write_file(stage, JSON_NAME, manifest.to_json().encode())
        mpd = write_file(stage, MPD_NAME, write_mpd(manifest))
        report = AuthorReport(manifest, tables.bytes + mpd.bytes, encoded - began, time.perf_counter() - encoded)
    return report
