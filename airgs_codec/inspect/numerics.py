"""Which stiff or extreme properties a package touches, and what holds for the rows that have them.

Looked at are the canonical spaces in Q0 and the states of L0, after decoding; bounds are `max_error` of these atlases
(FORMAT.md, section 4) and what float32 and half floats round. N rows of a group, n of a key tier or level.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding.channels import OPACITY_MARGIN, Canonical
from airgs_codec.coding.escapes import LIMIT
from airgs_codec.coding.grid import cell_bits
from airgs_codec.coding.motion import motion_units
from airgs_codec.decoder.decode import decode_canonical, decode_key, key_units
from airgs_codec.decoder.states import decode_pictures, decode_slopes
from airgs_codec.package.layout import STATE, Layout, key_layout
from airgs_codec.package.package import Package
from airgs_codec.package.tables import Atlas, Group
from airgs_codec.scene.frames import DROPPED, ZERO

FLOAT, HALF = 2.0**-24, 2.0**-11  # unit roundoffs of float32 and half floats
HALF_MOST = 65504.0  # largest half float: browsers end colours there
TEN_BITS = 1.5  # colour at which browsers end that can blend into ten bits alone (web/src/render/target.ts)
NEEDLE = 100.0  # longest over shortest axis: float32 covariances have the variance of the thin one to 6e-4 of it
NOTICED = 0.01  # of half a cell: what float32 rounds of coordinates is told from there on
COARSE = 0.125  # of the range of an attribute: a bound from there on leaves few values
NAMES = (
    *("needles", "spread of sizes", "far coordinates", "half-float coordinates", "end of the grid", "ends of opacity"),
    *("bright colours", "coarse steps", "codes past 8 bits", "motion past 8 bits", "repaired rows"),
)


@dataclass(frozen=True, slots=True)
class Touched:
    """A property that rows of a group have, how far it goes, and what holds for them."""

    what: str  # of NAMES
    group: int
    rows: int
    of: int  # rows of the group
    value: str
    verdict: str  # begins with exact, bounded by, does not fit or refused
    size: float  # larger is worse, among those of the same name


def measure_numerics(package: Package) -> list[Touched]:
    """The worst of each property over all groups, in the order of NAMES. Decodes every group; raises FormatError."""
    found = [one for number in range(len(package.manifest.groups)) for one in _group(package, number)]
    worst = (max((one for one in found if one.what == name), key=lambda t: t.size, default=None) for name in NAMES)
    return [one for one in worst if one is not None]


def format_numerics(found: list[Touched]) -> str:
    """A line for each property, and one of those that the scene has not."""
    lines = ["numerics: what this scene touches, at its worst, and what holds there:"]
    for t in found:
        lines += [f"{t.what}: {t.rows} of {t.of} rows of group {t.group}, {t.value}", f"    {t.verdict}"]
    others = [name for name in NAMES if name not in {t.what for t in found}]
    return "\n".join(lines + ([f"not touched: {', '.join(others)}"] if others else []))


def _group(package: Package, number: int) -> Iterator[Touched]:
    """All that a group touches."""
    group, base = package.manifest.groups[number], decode_canonical(package, number, 0)
    errors = _bounds([tier.qualities[0] for tier in group.tiers], key_layout(group))
    found = [*_sizes(base, errors), *_places(base, group), *_looks(base, errors), *_repairs(group)]
    if len(base.means):
        found += [*_key_codes(package, number, errors), *_motion(package, number)]
    for what, rows, size, value, verdict in found:
        yield Touched(what, number, rows, group.count, value, verdict, size)


_Found = tuple[str, int, float, str, str]  # what, rows, size, value, verdict


def _bounds(atlases: list[Atlas], layout: Layout) -> dict[str, float]:
    """`max_error` of each attribute, the largest over some atlases."""
    worst = np.max([atlas.max_error for atlas in atlases], axis=0, initial=0.0)
    return dict(zip(layout.attributes, np.broadcast_to(worst, len(layout.attributes)).tolist(), strict=True))


def _sizes(base: Canonical, errors: dict[str, float]) -> Iterator[_Found]:
    """Axes of one row and of all rows."""
    logs = base.log_scales.astype(np.float64)
    lengths, turn, scale = np.ptp(logs, axis=1), errors["quaternions"], errors["log_scales"]
    thin = lengths >= np.log(NEEDLE)
    if thin.any():
        ratio, longest = float(np.exp(lengths.max())), float(np.exp(logs[thin].max()))
        # The angle between two turns is at most the distance of their rotation vectors.
        moved = f"{turn:.3g} rad a channel, so that no end moves by more than {3**0.5 * turn * longest:.3g} units"
        words = f"bounded by {scale:.3g} of each ln scale and {moved}"
        if ratio**2 * FLOAT >= 1:
            words += "; does not fit renderers with covariances in float32, which lose the thin axis"
        yield "needles", int(thin.sum()), ratio, f"longest over shortest axis up to {ratio:.3g}", words
    spread = float(np.ptp(logs)) if logs.size else 0.0
    outside = (np.abs(logs) > np.log(2.0**63)).any(axis=1)  # whose square leaves the normal numbers of float32
    if outside.any() or spread > -np.log(FLOAT):
        words = f"bounded by {100 * np.expm1(scale):.3g} % of each size"
        if outside.any():
            words += "; does not fit covariances in float32"
        value = f"sizes from e^{logs.min():.3g} to e^{logs.max():.3g} units"
        yield "spread of sizes", int(outside.sum()) or len(logs), spread, value, words


def _places(base: Canonical, group: Group) -> Iterator[_Found]:
    """Coordinates beside the cells that hold them, and beside sizes."""
    if not len(base.means):
        return
    away = np.abs(base.means).max(axis=1)
    extent = float(np.ptp(base.means, axis=0).max())
    own = np.full(len(away), group.keeps is None)  # others: told of their base
    where = f"coordinates up to {away.max():.3g} in an extent of {extent:.3g} units"
    classes = np.rint(np.log2(base.motion_units)).astype(np.int16)
    half = group.grid.step * np.exp2(cell_bits(classes, group.grid, 0)) / 2
    shares = np.where(own, FLOAT * away / half, 0.0)
    if (far := shares >= NOTICED).any():
        worst = int(np.argmax(shares))
        fits = f"bounded by half a cell, {half[worst]:.3g} units, and what float32 rounds, {FLOAT * away[worst]:.3g}"
        wide = f"does not fit float32, which rounds by {FLOAT * away[worst]:.3g}, over half a cell, {half[worst]:.3g}"
        yield "far coordinates", int(far.sum()), float(shares.max()), where, wide if shares.max() > 1 else fits
    moves = np.where(away > HALF_MOST, np.inf, HALF * away) / np.exp(base.log_scales.max(axis=1).astype(np.float64))
    if (rounded := moves > 1).any():
        words = f"does not fit half floats, which move rows by up to {moves.max():.3g} times their size"
        yield "half-float coordinates", int(rounded.sum()), float(moves.max()), where, words
    if (clipped := own & (classes < group.grid.finest)).any():
        wider = int(group.grid.finest - classes[own].min())
        value = f"{group.grid.bits} bits an axis leave cells up to 2^{wider} times as wide as the steps ask for"
        words = f"bounded by half a cell, {group.grid.step / 2:.3g} units"
        yield "end of the grid", int(clipped.sum()), float(wider), value, words


def _looks(base: Canonical, errors: dict[str, float]) -> Iterator[_Found]:
    """Opacities and constant colours."""
    ends = (base.opacity < OPACITY_MARGIN) | (base.opacity > 1 - OPACITY_MARGIN)
    if ends.any():
        limit = float(np.log((1 - OPACITY_MARGIN) / OPACITY_MARGIN))
        value = f"alpha from {base.opacity.min():.3g} to {base.opacity.max():.3g}"
        words = f"bounded by {errors['opacity']:.3g} of alpha; logits end at ±{limit:.3g}"
        yield "ends of opacity", int(ends.sum()), float(ends.mean()), value, words
    bright = (0.5 + 0.28209479 * base.colours[:, :3].astype(np.float64)).max(axis=1, initial=0.0)
    if (over := bright > TEN_BITS).any():
        most = float(bright.max())
        ends_at = f"ten bits, where browsers end them at {TEN_BITS:g}, if blended half floats are not to be had"
        words = f"half floats, where browsers end them at {HALF_MOST:g}" if most > HALF_MOST else ends_at
        yield "bright colours", int(over.sum()), most, f"up to {most:.3g} of white", f"does not fit {words}"


def _repairs(group: Group) -> Iterator[_Found]:
    """What was repaired before coding, which the package tells in words."""
    for text, words in ((ZERO, "exact: they are identity"), (DROPPED, "refused: they were dropped")):
        counts = [int(count) for line in group.repairs for count in re.findall(rf"(\d+) {text}", line)]
        if counts:
            yield "repaired rows", sum(counts), float(sum(counts)), text, words


def _key_codes(package: Package, number: int, errors: dict[str, float]) -> Iterator[_Found]:
    """Steps beside the ranges of values, and codes that take escapes, attribute by attribute."""
    m = package.manifest
    group = m.groups[number]
    layout = key_layout(group)
    ranges, past = np.zeros(layout.width(m.colour_channels)), _Past.none(layout)
    for t, tier in enumerate(group.tiers):
        codes = decode_key(package, number, t, 0)[0] if tier.count else np.empty(0, np.int32)
        if codes.size:
            ranges = np.maximum(ranges, np.ptp(codes.astype(np.float64), axis=1) * key_units(package, number, t, 0))
            past = past.with_rows(layout, np.abs(codes - np.array(tier.qualities[0].centres)[:, None]))
    for name in layout.attributes:
        wide, error = float(ranges[layout.slice(name)].max()), errors[name]
        if group.keeps is None and wide > 0 and error >= COARSE * wide:
            value = f"{name} over a range of {wide:.3g}"
            yield "coarse steps", group.count, error / wide, value, f"bounded by {error:.3g}, {error / wide:.2g} of it"
    yield from past.found("codes past 8 bits", "")


def _motion(package: Package, number: int) -> Iterator[_Found]:
    """Changes of states that take escapes."""
    m = package.manifest
    group, worst = m.groups[number], np.zeros((1, 1), np.int64)
    atlas = group.levels[0]
    for s in m.segments_of(number):
        if m.state_files(s, 0):
            frames = m.segments[s].stop - m.segments[s].start
            for shown in decode_pictures(package, s, 0, range(frames)):
                worst = np.maximum(worst, np.abs(shown.codes() - np.array(atlas.centres)[:, None]))
            slopes = decode_slopes(package, s, 0)
            worst = worst if slopes is None else np.maximum(worst, np.abs(slopes))
    past, unit = _Past.none(STATE).with_rows(STATE, worst), motion_units(np.array([group.grid.finest], np.int16))[0]
    error = _bounds([atlas], STATE)["means"]
    yield from past.found("motion past 8 bits", f"; means bounded by {error:.3g} motion units (finest {unit:.3g})")


@dataclass(frozen=True, slots=True)
class _Past:
    """Samples that leave the 8 bits of pictures, so that escapes carry them: rows and largest distance by attribute."""

    rows: dict[str, int]
    most: dict[str, int]

    @staticmethod
    def none(layout: Layout) -> _Past:
        return _Past(dict.fromkeys(layout.attributes, 0), dict.fromkeys(layout.attributes, 0))

    def with_rows(self, layout: Layout, away: NDArray[np.integer]) -> _Past:
        """Add (channels, n) codes less centres, absolute."""
        parts = {name: away[layout.slice(name)].max(axis=0, initial=0) for name in layout.attributes}
        rows = {name: count + int((parts[name] > LIMIT).sum()) for name, count in self.rows.items()}
        return _Past(rows, {name: max(most, int(parts[name].max(initial=0))) for name, most in self.most.items()})

    def found(self, what: str, more: str) -> Iterator[_Found]:
        """The attribute that goes farthest, where one leaves."""
        name = max(self.most, key=lambda name: self.most[name])
        if most := self.most[name] * (self.most[name] > LIMIT):
            value = f"{name} up to {most} codes from their centre, of which 8 bits hold {LIMIT}"
            exact = "exact: escapes hold whole codes" if most * FLOAT < 1 else f"bounded by {FLOAT:.2g} of the value"
            yield what, self.rows[name], float(most), value, exact + more
