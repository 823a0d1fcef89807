"""The codec where its closed form for steps is ill-conditioned, and steps themselves from tiny to huge.

Scenes have a few hundred Gaussians; what is measured is coded as H.264 and decoded. C colour channels.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from airgs_codec.analysis.sensitivity import measure_sensitivity
from airgs_codec.coding import channels
from airgs_codec.coding.channels import colour_transform, fit_colour_transform, pack_matrix, unpack_matrix
from airgs_codec.coding.motion import FLOOR, StepSettings, classify_motion, get_step, motion_classes, motion_units
from airgs_codec.coding.sidecar import fit_grid
from airgs_codec.encoder.sample import PRESET, CalibrationSample, encode_and_decode
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.encoder.steps import PRIOR, STEP_CHANNELS, Slope, TrialGroup, balance, measure_slopes, solve_steps
from airgs_codec.encoder.streams import FLOAT_ROUNDING
from airgs_codec.media.h264 import CodecSettings, delta_codec, keyframe_codec, qp_step
from airgs_codec.package.layout import KEYFRAME
from airgs_codec.scene.gaussians import Gaussians
from tools.lab.numerics import outcome
from tools.lab.numerics.outcome import BOUNDED, DIVERGES, EXACT, NOT_FINITE, UNFIT, Case, Judged, grid
from tools.lab.numerics.problems import SIZE, cameras

LIMIT = ((1 + PRIOR) / PRIOR) ** 0.5  # of a factor on a step, and its inverse
ALIKE = 1.1  # factors this near to those without a limit are called equal
ROWS, FRAMES = 256, 4
MOST_LEVELS = 11  # of luma, by which H.264 may be off before samples leave their range (airgs_codec/coding/escapes.py)
WITH, WITHOUT = "with the limit", "without it"


def spread_slopes(kind: str, decades: float) -> dict[str, Slope]:
    """Slopes of twelve steps that save alike, whose errors range over so many decades."""
    least = 10.0**-decades
    errors = {
        "one hardly matters": [least] + [1.0] * (len(STEP_CHANNELS) - 1),
        "one is everything": [1.0] + [least] * (len(STEP_CHANNELS) - 1),
        "evenly spread": np.geomspace(1.0, least, len(STEP_CHANNELS)).tolist(),
    }[kind]
    return {name: (1.0, error) for name, error in zip(STEP_CHANNELS, errors, strict=True)}


def unlimited(slopes: Mapping[str, Slope]) -> dict[str, float]:
    rate, error = sum(m for m, _ in slopes.values()), sum(b for _, b in slopes.values())
    return {name: float(((m / rate) / (b / error)) ** 0.5) for name, (m, b) in slopes.items()}


def judge_spread(panel: str, kind: str, decades: float) -> Judged:
    """Factors on steps where the errors of steps range over so many decades, with the limit or without it."""
    slopes = spread_slopes(kind, decades)
    ideal = unlimited(slopes)
    return judge_factors(balance(slopes)[0] if panel == WITH else ideal, ideal)


def judge_factors(factors: Mapping[str, float], ideal: Mapping[str, float]) -> Judged:
    """Return whether factors are those of the optimum, how far apart they are, and what limits them."""
    largest, least = max(factors.values()), min(factors.values())
    if not np.isfinite([largest, least]).all() or least <= 0:
        return NOT_FINITE, np.inf, ""
    apart = largest / least
    if max(largest, 1 / least) > LIMIT * (1 + 1e-9):
        return DIVERGES, apart, ""
    equal = max(abs(np.log(factors[name] / ideal[name])) for name in factors) <= np.log(ALIKE)
    return (
        EXACT if equal else BOUNDED,
        apart,
        "" if equal else f"no factor beyond {outcome.number(LIMIT)} or its inverse",
    )


def cloud(rows: int = ROWS, seed: int = 0) -> Gaussians:
    """Gaussians of plausible sizes in a ball, SH degree 0."""
    rng = np.random.default_rng(seed)
    columns = (
        0.5 * rng.normal(size=(rows, 3)),
        rng.normal(size=(rows, 4)),
        np.log(SIZE / 3) + 0.4 * rng.normal(size=(rows, 3)),
        2 * rng.normal(size=rows),
        0.6 * rng.normal(size=(rows, 3)),
        np.zeros((rows, 0, 3)),
    )
    return Gaussians(*(column.astype(np.float32) for column in columns))


def _filled(name: str, value: float) -> Callable[[Gaussians], Gaussians]:
    return lambda g: replace(g, **{name: np.full_like(getattr(g, name), value)})


def _sized(g: Gaussians) -> Gaussians:
    sizes = np.linspace(np.log(1e-6), np.log(1e6), len(g), dtype=np.float32)
    return replace(g, log_scales=np.repeat(np.minimum(sizes, 3)[:, None], 3, axis=1))


def _wall(g: Gaussians) -> Gaussians:
    sizes, logits = g.log_scales.copy(), np.full_like(g.opacity_logits, -4.0)
    sizes[0], logits[0] = 2.0, 12.0
    return replace(g, log_scales=sizes, opacity_logits=logits)


SCENES: dict[str, Callable[[Gaussians], Gaussians]] = {
    "a plain cloud": lambda g: g, "balls: rotations do not matter": _filled("log_scales", np.log(SIZE / 3)),
    "one Gaussian hides the others": _wall, "sizes over seven decades": _sized,
    "nothing is seen": _filled("opacity_logits", -20.0), "all in one place": _filled("means", 0.25),
    "all equal": lambda g: g.take(np.zeros(len(g), np.intp)), "colours of a million": _filled("sh_dc", 1e6),
}  # fmt: skip


def sample_of(g: Gaussians) -> CalibrationSample:
    moves = (np.arange(len(g)) % 2)[:, None] * np.array([0.1, 0, 0], np.float32)
    frames = [replace(g, means=g.means + np.float32(np.sin(t)) * moves) for t in range(FRAMES)]
    sensitivity = measure_sensitivity(frames[:1], cameras(count=3))
    return CalibrationSample(
        index=np.arange(len(g)),
        keyframe=frames[0],
        frames=frames,
        classes=classify_motion(sensitivity.means, frames[0], 1.0),
        sensitivity=sensitivity,
        moving=np.ones(len(g), bool),
        factors=np.ones(len(g)),
        row_ratio=1.0,
        group_frames=FRAMES,
        segment_frames=FRAMES,
    )


def calibrated(sample: CalibrationSample) -> Judged:
    """How trial encodes change the steps, and whether bytes and error together fall at the price that they name."""
    settings = EncodeSettings(calibrate="steps", threads=1)
    subject = cast(
        TrialGroup, SimpleNamespace(settings=settings, frames=sample.frames, layout=SimpleNamespace(removal_error=0.0))
    )
    steps, price, _ = solve_steps(sample, subject)
    if price == 0:
        return UNFIT, 1.0, "neither bytes nor error depend on steps"
    slopes = [b for _, b in measure_slopes(sample, subject).values()]
    seen = [b for b in slopes if b > 0]
    before, after = sample.cost(settings.steps), sample.cost(steps)
    factors = [get_step(steps, n) / get_step(settings.steps, n) for n in STEP_CHANNELS]
    errors = [cost.keyframe_error + cost.delta_error for cost in (before, after)]
    gain = (errors[1] + price * after.bytes) / (errors[0] + price * before.bytes)
    words = (
        f"errors of steps {max(seen) / min(seen):.1g} apart, {len(slopes) - len(seen)} of {len(slopes)} without any; "
        f"steps x {min(factors):.2g} to {max(factors):.2g}; "
        f"{before.bytes:.0f} to {after.bytes:.0f} B a frame, error x {errors[1] / errors[0]:.2g}"
    )
    at_limit = max(*factors, *(1 / f for f in factors)) > 0.9 * LIMIT
    end = DIVERGES if gain > ALIKE else BOUNDED if at_limit else EXACT
    return end, gain, words


def code_deltas(sample: CalibrationSample, factor: float) -> Judged:
    """Deltas at steps times a factor: largest error in steps, and the bytes."""
    steps = StepSettings()
    deltas = sample.deltas(sample.code_keyframe(steps, 1.0)[1], steps)
    size, errors = sample.code_deltas(deltas, factor)
    rounding = FLOAT_ROUNDING * float(np.abs(deltas).max()) / factor
    return _coded(float(np.abs(errors).max() / factor), size, _most(delta_codec(PRESET)) + rounding)


def code_keyframes(sample: CalibrationSample, factor: float) -> Judged:
    """Keyframes at steps times a factor: largest error in steps, and the bytes."""
    steps = StepSettings()
    transform = colour_transform(sample.keyframe, steps.keyframe)
    values = channels.keyframe_channels(sample.keyframe, transform, steps.keyframe, steps.grid)
    units = KEYFRAME.steps(steps.keyframe, 3) * factor
    sizes, decoded = encode_and_decode(values[None], units, keyframe_codec(PRESET))
    rounding = FLOAT_ROUNDING * float((np.abs(values) / units[:, None]).max())
    error = float((np.abs(decoded[0] - values) / units[:, None]).max())
    return _coded(error, float(sizes[0]), _most(keyframe_codec(PRESET)) + rounding)


def _most(codec: CodecSettings) -> float:
    """Steps by which a decoded value may be off: half a code, and what H.264 may add."""
    return (0.5 + MOST_LEVELS) / qp_step(codec.qp)


def _coded(error: float, size: float, most: float) -> Judged:
    if not np.isfinite(error):
        return NOT_FINITE, error, ""
    words = f"{size:.0f} B" if size else "nothing is sent"
    return (BOUNDED if error <= most else DIVERGES), error, f"by {outcome.number(most)} steps ({words})"


def klt_error(decades: float, invert: bool) -> Judged:
    """Relative error of colours through the stored KLT, where their channels' spread ranges over so many decades."""
    rng = np.random.default_rng(0)
    spread = np.geomspace(1.0, 10.0**-decades, 12)
    mixed = np.linalg.qr(rng.normal(size=(12, 12)))[0]
    scaled = (rng.normal(size=(ROWS, 12)) * spread) @ mixed
    stored = unpack_matrix(pack_matrix(fit_colour_transform(scaled)), 12)
    channels = scaled @ np.linalg.inv(stored) if invert else scaled @ stored.T
    back = channels.astype(np.float32) @ stored.astype(np.float32)
    error = float(np.abs(back - scaled).max() / np.abs(scaled).max())
    return outcome.error_end(error, 1e-6), error, f"condition of the stored transform {np.linalg.cond(stored):.5f}"


def judge_classes(decades: float) -> Judged:
    """Whether motion units follow row sensitivities that range over so many decades; the grid steps they span."""
    sensitivity: NDArray[np.float64] = np.geomspace(10.0**-decades, 1.0, ROWS)
    classes = motion_classes(sensitivity, FLOOR * float(np.median(sensitivity)))
    wanted, unit = sensitivity**-0.25, motion_units(classes).astype(np.float64)
    off = float(np.abs(np.log2(unit / wanted)).max())
    grid = fit_grid(cloud().means, classes, StepSettings().grid)
    if not np.isfinite(unit).all():
        return NOT_FINITE, off, ""
    steps = float(np.ptp(cloud().means)) / grid.step
    if off <= 0.5 + 1e-6:
        return EXACT, steps, ""
    kinds = len(np.unique(classes))
    return BOUNDED, steps, f"by {kinds} classes; rows under a hundredth of the median share the coarsest"


KINDS = ("one hardly matters", "one is everything", "evenly spread")
CODERS: dict[str, Callable[[CalibrationSample, float], Judged]] = {"keyframes": code_keyframes, "deltas": code_deltas}


def cases() -> list[Case]:
    return [
        Case(
            part="codec", name="codec-closed-form", title="Closed form for steps",
            label="decades of the errors of steps", value="largest factor on a step / least", own=(WITH, ""),
            points=grid([WITH, WITHOUT], KINDS, (0.0, 0.5, 1.0, 2.0, 3.0, 6.0, 12.0, 24.0, 300.0)),
            judge=judge_spread, why=f"a limit on factors of {outcome.number(LIMIT)} and its inverse",
        ),
        Case(
            part="codec", name="codec-steps", title="Steps from tiny to huge", label="factor on all steps",
            value="largest error in steps", own=("coded", ""),
            points=grid(["coded"], CODERS, [10.0**e for e in (-300, -12, -9, -8, -6, -4, -2, 0, 2, 4, 8, 300)]),
            judge=lambda panel, kind, factor: CODERS[kind](sample_of(cloud()), factor),
            why="what H.264 may add ({span} steps)",
            refused="values beyond 2^30 codes, steps that float32 cannot hold",
        ),
        Case(
            part="codec", name="codec-klt", title="Colours on a line", label="decades of the spread of colours",
            value="error / largest colour", own=("inverted", ""),
            points=grid(["inverted", "transposed"], ["colours"], (0.0, 2.0, 4.0, 6.0, 8.0, 12.0, 30.0, 300.0)),
            judge=lambda panel, row, decades: klt_error(decades, panel == "inverted"),
        ),
        Case(
            part="codec", name="codec-classes", title="Rows that matter unequally",
            label="decades of the sensitivities of rows", value="bits of an axis of the grid", own=("classes", ""),
            points=grid(["classes"], ["rows"], (0.0, 1.0, 2.0, 4.0, 6.0, 9.0, 12.0, 24.0, 100.0, 300.0)),
            judge=lambda panel, row, decades: judge_classes(decades),
            why="the coarsest class, which rows under a hundredth of the median share",
        ),
        Case(
            part="codec", name="codec-scenes", title="Calibration of made scenes", label="",
            value="bytes at their price and error, after / before", own=("calibrated", ""),
            points=grid(["calibrated"], SCENES, [0.0]),
            judge=lambda panel, name, _: calibrated(sample_of(SCENES[name](cloud()))),
            why="that limit, where nobody sees an error",
        ),
    ]  # fmt: skip
