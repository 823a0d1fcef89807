"""The formulas of FORMAT.md, sections 4 and 5, for one row and one number at a time, in float64.

Every result comes with what a decoder in float32 may be off by (FORMAT.md, "Precision").
"""

from __future__ import annotations

import base64
import math
import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from tests.faces import Grid
from tests.makers.vectors.text import plain
from tests.support.vectors import Case

Steps = Mapping[str, float]
ULP = 2.0**-24  # half a unit in the last place of a float32, relative
LEAST_ALPHA = 2.0**-20


@dataclass(frozen=True, slots=True)
class Number:
    """A sum, and the sum of the sizes of its terms."""

    value: float
    size: float

    def __add__(self, other: Number) -> Number:
        return Number(self.value + other.value, self.size + other.size)


def total(terms: Iterable[float]) -> Number:
    listed = list(terms)
    return Number(math.fsum(listed), math.fsum(map(abs, listed)))


@dataclass(frozen=True, slots=True)
class Rotation:
    """A unit quaternion w, x, y, z, and the sum of the angles of the rotations that it is the product of."""

    quaternion: tuple[float, float, float, float]
    angle: float

    def __mul__(self, other: Rotation) -> Rotation:
        aw, ax, ay, az = self.quaternion
        bw, bx, by, bz = other.quaternion
        product = (
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        )
        return Rotation(product, self.angle + other.angle)


def rotation(vector: Sequence[float]) -> Rotation:
    angle = math.sqrt(math.fsum(v * v for v in vector))
    x, y, z = (v * (math.sin(angle / 2) / angle if angle else 0.5) for v in vector)
    return Rotation((math.cos(angle / 2), x, y, z), angle)


def rotated(quaternion: Sequence[float]) -> Rotation:
    """A rotation that is given, not computed."""
    w, x, y, z = quaternion
    return Rotation((w, x, y, z), 0.0)


@dataclass(frozen=True, slots=True)
class Coding:
    steps: Steps
    factor: float
    gain: float
    transform: Sequence[Sequence[float]]  # K, C x C
    unit: float = 1.0  # world units that log-scales of keys are coded in

    def values(self, codes: Sequence[float], step: str) -> list[float]:
        return [code * self.steps[step] * self.factor / self.gain for code in codes]

    def colours(self, codes: Sequence[float]) -> list[Number]:
        y = [code * self.factor / self.gain for code in codes]
        scale = [self.steps["sh_dc" if i < 3 else "sh_rest"] for i in range(len(y))]
        return [total(y[k] * self.transform[k][i] * scale[i] for k in range(len(y))) for i in range(len(y))]


@dataclass(frozen=True, slots=True)
class Row:
    means: list[Number]
    quaternions: Rotation
    log_scales: list[Number]
    alpha: Number  # before it is limited
    colours: list[Number]


def key_row(codes: Sequence[float], coding: Coding, mean: Sequence[float] = (0.0, 0.0, 0.0)) -> Row:
    return Row(
        means=[total([v]) for v in mean],
        quaternions=rotation(coding.values(codes[3:6], "quaternions")),
        log_scales=[total([math.log(coding.unit), v]) for v in coding.values(codes[:3], "log_scales")],
        alpha=total(coding.values(codes[6:7], "opacity")),
        colours=coding.colours(codes[7:]),
    )


def state_row(row: Row, codes: Sequence[float], coding: Coding, motion_class: int) -> Row:
    """The row with the state that 10 + C codes make."""
    unit = 2.0**motion_class
    shift = [total([v * unit]) for v in coding.values(codes[:3], "means")]
    growth = [total([v]) for v in coding.values(codes[3:6], "log_scales")]
    return Row(
        means=[a + b for a, b in zip(row.means, shift, strict=True)],
        quaternions=rotation(coding.values(codes[6:9], "quaternions")) * row.quaternions,
        log_scales=[a + b for a, b in zip(row.log_scales, growth, strict=True)],
        alpha=row.alpha + total(coding.values(codes[9:10], "opacity")),
        colours=[a + b for a, b in zip(row.colours, coding.colours(codes[10:]), strict=True)],
    )


def listed(rows: Sequence[Row], *, limit: bool) -> dict[str, Any]:
    """Rows as vectors have them, with their tolerances; `limit` the alpha, as it is where rows are shown."""
    return {"values": _values(rows, limit), "tolerance": _tolerances(rows)}


def _values(rows: Sequence[Row], limit: bool) -> dict[str, object]:
    alpha = [row.alpha.value for row in rows]
    if limit:
        alpha = [min(max(a, LEAST_ALPHA), 1 - LEAST_ALPHA) for a in alpha]
    return {
        "means": plain([[n.value for n in row.means] for row in rows]),
        "quaternions": plain([row.quaternions.quaternion for row in rows]),
        "log_scales": plain([[n.value for n in row.log_scales] for row in rows]),
        "alpha": plain(alpha),
        "colours": plain([[n.value for n in row.colours] for row in rows]),
    }


def _tolerances(rows: Sequence[Row]) -> dict[str, object]:
    return {
        "means": [_up(8 * max(n.size for n in row.means)) for row in rows],
        "quaternions": [_up(8 * (6 + row.quaternions.angle)) for row in rows],
        "log_scales": [_up(8 * max(n.size for n in row.log_scales)) for row in rows],
        "alpha": [_up(8 * max(row.alpha.size, LEAST_ALPHA)) for row in rows],
        "colours": [_up((8 + len(row.colours)) * max(n.size for n in row.colours)) for row in rows],
    }


def _up(ulps: float) -> float:
    """So many halves of a last place to two digits, rounded up."""
    text = f"{1.05 * ulps * ULP:.1e}"
    return float(text)


def coding_of(case: Case) -> Coding:
    """What a case says of its coding; only keys have a grid, whose unit their log-scales are coded in."""
    transform = unpack_transform(case["colour_transform"])
    unit = Grid(**case["grid"]).unit if "grid" in case else 1.0
    return Coding(case["steps"], case["factor"], case["gain"], transform, unit)


def unpack_transform(text: str) -> list[list[float]]:
    """What a `colour_transform` decodes to, row by row."""
    entries = [entry / 32767 for (entry,) in struct.iter_unpack("<h", base64.b64decode(text))]
    side = math.isqrt(len(entries))
    return [entries[start : start + side] for start in range(0, len(entries), side)]
