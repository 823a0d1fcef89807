"""Bytes of a frame at 43 dB against seconds of the encoder.

Points are x264's presets, calibrated or not, `--preset fast`, and how many pictures decide.

The quality factor is interpolated between two encodes near the target. PSNR is that of the package, from views by
which nothing was decided. Seconds are those of the whole encode but for measuring.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import EncodeSettings, LevelSettings, as_fast
from airgs_codec.package.manifest import Manifest, quality_of
from airgs_codec.scene.sequence import GaussianSequence
from tools.lab import Took, seconds_of
from tools.lab.numerics.rows import Bench, Place, Point, Row

TARGET = 43.0  # dB
MEASURED = 64  # pictures that measure
PRESETS = ("ultrafast", "medium", "veryslow")
REPEATS = 3
ONE_RUNG = EncodeSettings(
    calibrate="none", levels=(LevelSettings(0.0),), keyframe_factors=(1.0,), measure_pictures=MEASURED
)
DECIDING = (2, 6, 48)  # --decide-pictures
PLAIN, CALIBRATED, FAST, DECIDED = "default steps", "calibrated", "--preset fast", "pictures that decide"
UNIT = "kB a frame at 43 dB"


@dataclass(frozen=True, slots=True)
class Trial:
    psnr: float  # dB, of the package; NaN if it was not measured
    bytes: float  # a frame, of all that a viewer fetches but manifests


def measure(bench: Bench) -> Iterator[Point]:
    """A row for each preset, calibrated and not, for `--preset fast`, and for each number of deciding pictures."""
    for scene in bench.scenes:
        whole = scene is bench.scenes[0] and not bench.quick
        for curve, setting, settings in variants(PRESETS if whole else PRESETS[-1:], DECIDING if whole else ()):
            place = Place("encode", scene.name, curve, setting)
            make = partial(_row, place, scene.sequence, settings, REPEATS)
            yield Point("encode", scene, {"place": place, "repeats": REPEATS}, make)


def _row(place: Place, sequence: GaussianSequence, settings: EncodeSettings, repeats: int) -> list[Row]:
    size, took = at_target(sequence, settings, repeats)
    return [Row.of(place, took, [size / 1e3], UNIT)]


def variants(presets: Sequence[str], deciding: Sequence[int]) -> Iterator[tuple[str, str, EncodeSettings]]:
    calibrated = replace(ONE_RUNG, calibrate="steps")
    for preset in presets:
        yield PLAIN, preset, replace(ONE_RUNG, preset=preset)
    for preset in dict.fromkeys((presets[0], presets[-1])):
        yield CALIBRATED, preset, replace(calibrated, preset=preset)
    for count in deciding:
        yield DECIDED, str(count), replace(calibrated, decide_pictures=count)
    yield FAST, FAST, replace(as_fast(ONE_RUNG), measure_pictures=MEASURED)


def at_target(sequence: GaussianSequence, settings: EncodeSettings, repeats: int) -> tuple[float, list[Took]]:
    """Bytes of a frame at TARGET, and what encodes near it take without measuring."""
    first, _ = run(sequence, settings)
    factor = float(np.clip(10 ** ((first.psnr - TARGET) / 20), 0.05, 20.0))
    if 0.8 < factor < 1.25:  # too near for a slope
        factor = 1.25 if first.psnr > TARGET else 0.8
    second, _ = run(sequence, settings, factor)
    near = 1.0 if abs(first.psnr - TARGET) < abs(second.psnr - TARGET) else factor
    alone = replace(settings, measure_pictures=0)
    return bytes_at(TARGET, first, second), [run(sequence, alone, near)[1] for _ in range(repeats)]


def bytes_at(psnr: float, a: Trial, b: Trial) -> float:
    """Bytes of a frame at a PSNR, linear in dB and the logarithm of bytes through two trials of different PSNR."""
    share = (psnr - a.psnr) / (b.psnr - a.psnr)
    return float(a.bytes * (b.bytes / a.bytes) ** share)


def run(sequence: GaussianSequence, settings: EncodeSettings, factor: float = 1.0) -> tuple[Trial, Took]:
    with tempfile.TemporaryDirectory() as name:
        target, finer = Path(name) / "package", replace(settings, quality=factor)
        took, report = seconds_of(lambda: encode(sequence, target, finer))
        return trial_of(report.manifest), took


def trial_of(m: Manifest) -> Trial:
    quality = quality_of(m, 0, 0)
    size = m.bytes_of(m.rung_files(0, 0)) / m.frames
    return Trial(float("nan") if quality is None else quality.psnr, size)
