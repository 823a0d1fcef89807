"""The errors of a package against the sequence it was made of, attribute by attribute, and what it promises.

The order of rows in a package is not stored. Each row is matched with an original by all attributes but SH rest, in
three frames of the group where it has deltas, else in the mean of all frames: with the nearest, in steps, of those
within what is promised, or the nearest where none is. N rows of a group.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from airgs_codec._arguments import argument
from airgs_codec.analysis.rows import AUTO, restore_rows
from airgs_codec.coding.channels import LEAST_DRAWN, Canonical, delta_channels, frame_channels, keyframe_channels
from airgs_codec.decoder.decode import decode_canonical, decode_pictures, decode_segment, read_keyframe
from airgs_codec.errors import ConfigError
from airgs_codec.package.layout import DELTA, Layout, keyframe_layout
from airgs_codec.package.package import OPENED, Package, open_package
from airgs_codec.package.tables import STATIC, Group
from airgs_codec.scene.frames import turn_least
from airgs_codec.scene.gaussians import Gaussians, mean_frame, mix_rows, to_matrices
from airgs_codec.scene.sequence import GaussianSequence, open_sequence

Original = GaussianSequence | str | Path
Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Rows = NDArray[np.intp]
CLOSEST = 4  # originals of which a row may be one
FEATURE_WIDTHS = (3, 3, 9, 1, 3)  # by which rows are matched: rotations as matrices, of colours DC


@dataclass(frozen=True, slots=True)
class Measured:
    """The largest error of an attribute in an atlas, in the units of its channels."""

    where: str
    attribute: str
    bound: float  # `max_error` of the atlas
    error: float
    rows: int  # compared
    ambiguous: int  # rows left out: more of them than there are such originals are matched with one


def input_rows(
    package: Package | str | Path, original: Original, start: int, stop: int, *, level: str | int = "L0"
) -> Iterator[NDArray[np.int32]]:
    """Yield for each frame that `decode_frames` gives which row of the original's frame every row is, (N,).

    It is found by what the rows are, as `measure_errors` does; -1 where the original has no such row, or several
    would do. Raises ConfigError, FormatError, SceneError.
    """
    package = argument("package", package, Package, OPENED, open_package)
    given = argument("original", original, GaussianSequence, "an open sequence or the path of one", open_sequence)
    tiers = package.manifest.levels[package.manifest.level_index(level)].tiers
    sequence = _in_order(package, given)
    for index, group in enumerate(package.manifest.groups):
        if numbers := range(max(start, group.start), min(stop, group.stop)):
            base = decode_canonical(package, index, 0)
            rows, sure = _match(package, index, group, base, _frames(package, group, sequence))
            sure &= np.bincount(rows)[rows] == 1
            found = np.where(sure, rows, -1).astype(np.int32)[: sum(tier.count for tier in group.tiers[:tiers])]
            for number in numbers:
                order = sequence.orders.get(number)
                yield found if order is None else np.where(found < 0, -1, order[found])


def measure_errors(package: Package, sequence: GaussianSequence) -> Iterator[Measured]:
    """Yield the errors of every keyframe atlas and every level of every group. Raises ConfigError, FormatError,
    SceneError.

    Rows of the sequence that lost their order are matched again as the encoder did.
    """
    sequence = _in_order(package, sequence)
    for index, group in enumerate(package.manifest.groups):
        frames = _frames(package, group, sequence)
        base = decode_canonical(package, index, 0)
        rows, sure = _match(package, index, group, base, frames)
        originals = [g.take(rows) for g in frames]
        yield from _keyframes(package, index, group, base, mean_frame(frames).take(rows), sure)
        yield from _deltas(package, index, base, originals, sure)


def _in_order(package: Package, sequence: GaussianSequence) -> GaussianSequence:
    """Return the original as the encoder took it, from the package's origin, rows in order. Raises ConfigError."""
    m = package.manifest
    if len(sequence) != m.frames or sequence.sh_degree < m.sh_degree:
        expected = f"{sequence.name_of(sequence.folder)}: expected {m.frames} frames of SH degree {m.sh_degree}"
        raise ConfigError(f"{expected} or more, got {len(sequence)} of {sequence.sh_degree}")
    sequence = sequence.at_origin(package.origin)
    return restore_rows(sequence, m.generator.settings.get("rows", AUTO)).sequence


def _frames(package: Package, group: Group, sequence: GaussianSequence) -> list[Gaussians]:
    frames = turn_least(sequence.load(range(group.start, group.stop))).frames
    return [frame.with_degree(package.manifest.sh_degree) for frame in frames]


def _held(frames: list[Gaussians]) -> list[Gaussians]:
    """Return frames whose rows, where not drawn, are those last drawn, or first to be, but for alpha."""
    drawn = [g.opacities() >= LEAST_DRAWN for g in frames]
    held = frames[-1]
    for g, rows in zip(reversed(frames), reversed(drawn), strict=True):
        held = mix_rows(g, held, rows)
    out = []
    for g, rows in zip(frames, drawn, strict=True):
        held = mix_rows(g, held, rows)
        out.append(replace(held, opacity_logits=g.opacity_logits))
    return out


def _match(p: Package, index: int, group: Group, base: Canonical, frames: list[Gaussians]) -> tuple[Rows, Flags]:
    """Return the original of every row, (N,), and (N,) False where more rows have it than there are such originals."""
    m, frames = p.manifest, _held(frames)
    picks = sorted({0, len(frames) // 2, len(frames) - 1})
    decoded: list[Gaussians] = []
    for number in (group.start + pick for pick in picks):
        segment = m.segment_at(number)
        decoded += decode_segment(p, segment, base, 0, [number - m.segments[segment].start])
    scale = float(np.median(base.motion_units)) * group.delta_steps.means
    promised, still = _promised(group, base), base.depths == STATIC
    features = _features([frames[pick] for pick in picks], group, scale)
    rows = np.empty(len(still), np.intp)
    rows[~still] = _nearest(features, _features(decoded, group, scale)[~still], promised[~still])
    mean = _features([mean_frame(frames)], group, scale)
    rows[still] = _nearest(mean, _features([base.to_gaussians()], group, scale)[still], promised[still])
    _, twin, twins = np.unique(features, axis=0, return_inverse=True, return_counts=True)
    twin = twin.ravel()  # equal originals are as good as one another
    taken = np.bincount(twin[rows], minlength=len(twins))
    return rows, (taken <= twins)[twin[rows]]


def _nearest(originals: Floats, found: Floats, promised: Floats) -> Rows:
    """Return the original of each row found, (n, 19 F): the first candidate within what is promised, (n, 19)."""
    _, near = cKDTree(originals).query(found, range(1, 1 + min(CLOSEST, len(originals))), workers=-1)
    allowed = np.tile(promised, originals.shape[1] // promised.shape[1])
    within = np.stack([(np.abs(found - originals[rows]) <= allowed).all(1) for rows in near.T], axis=1)
    return np.asarray(np.take_along_axis(near, within.argmax(1)[:, None], axis=1)[:, 0])


def _promised(group: Group, base: Canonical) -> Floats:
    """Return what each feature may err by, (N, 19): of rows with deltas in the top level, of others in their keyframe.

    Colours have it from all C channels; a keyframe that is no difference promises nothing of means.
    """
    steps, still = group.delta_steps, base.depths == STATIC
    rows, first = [], 0
    level = group.levels[0].max_error
    for tier in group.tiers:
        part = slice(first, first := first + tier.count)
        keyframe = tier.qualities[0].max_error
        keyframe = [np.inf] * (len(level) - len(keyframe)) + keyframe
        rows.append(np.where(still[part, None], keyframe, level))
    units = [*(getattr(steps, name) for name, _ in DELTA.runs), 1.0]
    promised = np.repeat(np.concatenate(rows) / units, FEATURE_WIDTHS, axis=1)
    promised[:, :3] *= (base.motion_units / np.median(base.motion_units))[:, None]
    promised[:, -3:] *= np.abs(base.transform)[:, :3].sum(axis=0)
    promised[still, -3:] *= group.keyframe_steps.sh_dc / steps.sh_dc
    return promised


def _features(frames: list[Gaussians], group: Group, scale: float) -> Floats:
    """Return (N, 19 F) in steps; rotations as matrices: no half turns, they differ by sqrt(2) times small angles."""
    steps = group.delta_steps
    each = []
    for g in frames:
        means, opacity = g.means.astype(np.float64) / scale, g.opacities()[:, None] / steps.opacity
        turns = to_matrices(g.quaternions).reshape(len(g), 9) / (2**0.5 * steps.quaternions)
        each += [means, g.log_scales / steps.log_scales, turns, opacity, g.sh_dc / steps.sh_dc]
    return np.hstack(each)


def _keyframes(
    package: Package, index: int, group: Group, base: Canonical, original: Gaussians, sure: Flags
) -> Iterator[Measured]:
    m = package.manifest
    layout, against, compared = keyframe_layout(group), m.base_of(index), sure
    for q, quality in enumerate(m.qualities):
        if against is None:
            values = keyframe_channels(original, base.transform, group.keyframe_steps, group.grid.unit)
        else:
            reference = decode_canonical(package, against, q)
            values, drawn = frame_channels(original, reference, group.difference_steps)
            compared = sure & drawn  # others differ by nothing
        first = 0
        for t, tier in enumerate(group.tiers):
            part = slice(first, first := first + tier.count)
            if tier.count:
                shown, _ = read_keyframe(package, index, t, q)
                errors = np.abs(values[:, part] - (shown.values(slice(None)) if shown else 0))
                where = f"group {index} keyframe T{t} {quality.id}"
                yield from _measured(where, layout, tier.qualities[q].max_error, errors, compared[part])


def _deltas(p: Package, index: int, base: Canonical, originals: list[Gaussians], sure: Flags) -> Iterator[Measured]:
    m, quality = p.manifest, 0
    group = m.groups[index]
    values = delta_channels(originals, base, group.delta_steps)
    steps = DELTA.steps(group.delta_steps, m.colour_channels)
    for j, level in enumerate(m.levels):
        if level.quality != quality:  # deltas are differences to the keyframe quality of their level
            quality = level.quality
            base = decode_canonical(p, index, quality)
            values = delta_channels(originals, base, group.delta_steps)
        rows = np.flatnonzero((base.depths >= j) & (base.depths != STATIC))
        worst = np.zeros((len(steps), len(rows)))
        sent = [s for s in m.segments_of(index) if m.delta_files(s, j)]
        for s in sent:
            segment = m.segments[s]
            for t, delta in enumerate(decode_pictures(p, s, j, range(segment.stop - segment.start))):
                decoded = delta.values(slice(None))
                shown = [_shown(v, base, rows) for v in (values[segment.start - group.start + t][:, rows], decoded)]
                worst = np.maximum(worst, np.abs(shown[0] - shown[1]))
        if sent:
            where = f"group {index} delta {level.id}"
            yield from _measured(where, DELTA, group.levels[j].max_error, worst, sure[rows])


def _shown(channels: NDArray[np.floating], base: Canonical, rows: NDArray[np.intp]) -> NDArray[np.floating]:
    """Return (10 + C, n) delta channels of some rows with the change of alpha that is shown: no alpha is below 0."""
    out = channels.copy()
    out[DELTA.slice("opacity")] = np.maximum(out[DELTA.slice("opacity")], -base.opacity[rows])
    return out


def _measured(where: str, layout: Layout, bounds: list[float], errors: Floats, sure: Flags) -> Iterator[Measured]:
    places = layout.attribute_index(len(errors))
    for k, (name, bound) in enumerate(zip(layout.attributes, bounds, strict=True)):
        error = float(errors[places == k][:, sure].max(initial=0.0))
        yield Measured(where, name, bound, error, int(sure.sum()), int((~sure).sum()))


def format_errors(measured: list[Measured]) -> str:
    """Return a line for each atlas: what was measured and what `max_error` promises, for each attribute."""
    lines = ["largest error, measured / max_error, in the units of the channels (FORMAT.md, section 5):"]
    for where in dict.fromkeys(m.where for m in measured):
        same = [m for m in measured if m.where == where]
        cells = ", ".join(f"{m.attribute} {m.error:.3g} / {m.bound:.3g}" for m in same)
        left = f" ({same[0].ambiguous} of {same[0].rows + same[0].ambiguous} rows ambiguous)" * bool(same[0].ambiguous)
        lines.append(f"{where}: {cells}{left}")
    return "\n".join(lines)
