"""Values of rows by the formulas of FORMAT.md, sections 4, 5 and 8, in float64: keyframes, deltas, what is shown,
viewers.

Every result comes with what a decoder in float32 may be off by (FORMAT.md, "Precision"). n rows, C colour channels.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tests.faces import Grid
from tests.support.regions import departure
from tests.support.vectors import Case, Table, cases, data, plain

Floats = NDArray[np.float64]
ATTRIBUTES = ("means", "quaternions", "log_scales", "alpha", "colours")
ULP = 2.0**-24  # half a unit in the last place of a float32, relative
LEAST_ALPHA = 2.0**-20
STATIC = 255


def term(values: ArrayLike) -> Floats:
    """(n, k) terms -> (2, n, k) sums and the sums of the sizes of their terms: what is added to it adds to both."""
    return np.stack([values, np.abs(values)]).astype(np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    means: Floats  # (2, n, 3) terms, as are all but rotations
    quaternions: Floats  # (n, 4) w, x, y, z
    angles: Floats  # (n, 1) of the rotations that each is the product of, added up
    log_scales: Floats
    alpha: Floats  # before it is limited
    colours: Floats

    @staticmethod
    def join(parts: Sequence[Rows]) -> Rows:
        columns = ([getattr(part, field.name) for part in parts] for field in fields(Rows))
        return Rows(*(np.concatenate(column, axis=-2) for column in columns))

    def take(self, rows: slice) -> Rows:
        return Rows(*(getattr(self, field.name)[..., rows, :] for field in fields(Rows)))


def rotations(vectors: Floats) -> tuple[Floats, Floats]:
    """(n, 3) vectors -> (n, 4) quaternions and (n, 1) angles."""
    angles = np.linalg.norm(vectors, axis=1, keepdims=True)
    half = np.where(angles, np.sin(angles / 2) / np.where(angles, angles, 1), 0.5)
    return np.hstack([np.cos(angles / 2), vectors * half]), angles


def product(a: Floats, b: Floats) -> Floats:
    (aw, ax, ay, az), (bw, bx, by, bz) = a.T, b.T
    w = aw * bw - ax * bx - ay * by - az * bz
    x = aw * bx + ax * bw + ay * bz - az * by
    y = aw * by - ax * bz + ay * bw + az * bx
    z = aw * bz + ax * by - ay * bx + az * bw
    return np.stack([w, x, y, z], axis=1)


@dataclass(frozen=True, slots=True)
class Coding:
    steps: Mapping[str, float]
    factor: float
    gain: float
    transform: Floats  # K, (C, C)
    unit: float = 1.0  # world units that log-scales of keyframes are coded in

    def values(self, codes: Floats, step: str) -> Floats:
        return codes.T * self.steps[step] * self.factor / self.gain

    def colours(self, codes: Floats) -> Floats:
        y = codes.T * self.factor / self.gain
        scale = np.array([self.steps["sh_dc" if i < 3 else "sh_rest"] for i in range(len(codes))])
        return np.stack([y @ self.transform * scale, np.abs(y) @ np.abs(self.transform) * scale])


def keyframe_rows(codes: Floats, coding: Coding, means: ArrayLike) -> Rows:
    """The rows that (7 + C, n) codes of keyframes make at (n, 3) means."""
    return Rows(
        term(means),
        *rotations(coding.values(codes[3:6], "quaternions")),
        term([[math.log(coding.unit)]]) + term(coding.values(codes[:3], "log_scales")),
        term(coding.values(codes[6:7], "opacity")),
        coding.colours(codes[7:]),
    )


def delta_rows(rows: Rows, codes: Floats, coding: Coding, classes: ArrayLike) -> Rows:
    """The rows with the delta that (10 + C, n) codes make; where all codes of a row are 0, it stays as it is."""
    turns, angles = rotations(coding.values(codes[6:9], "quaternions"))
    units = 2.0 ** np.array(classes)[:, None]
    return Rows(
        rows.means + term(coding.values(codes[:3], "means") * units),
        product(turns, rows.quaternions),
        rows.angles + angles,
        rows.log_scales + term(coding.values(codes[3:6], "log_scales")),
        rows.alpha + term(coding.values(codes[9:10], "opacity")),
        rows.colours + coding.colours(codes[10:]),
    )


def listed(rows: Rows, *, limit: bool) -> dict[str, Any]:
    """Rows as vectors have them, with their tolerances; `limit` the alpha, as it is where rows are shown."""
    (means, sizes), (log_scales, scale_sizes) = rows.means, rows.log_scales
    (alpha, alpha_sizes), (colours, colour_sizes) = rows.alpha[..., 0], rows.colours
    alpha = np.clip(alpha, LEAST_ALPHA, 1 - LEAST_ALPHA) if limit else alpha
    values = means, rows.quaternions, log_scales, alpha, colours
    ulps = [8 * sizes.max(axis=1), 8 * (6 + rows.angles[:, 0]), 8 * scale_sizes.max(axis=1)]
    ulps += [8 * np.maximum(alpha_sizes, LEAST_ALPHA), (8 + colours.shape[1]) * colour_sizes.max(axis=1)]
    tolerance = ([float(f"{1.05 * ulp * ULP:.1e}") for ulp in one.tolist()] for one in ulps)
    return {
        "values": dict(zip(ATTRIBUTES, (plain(one.tolist()) for one in values), strict=True)),
        "tolerance": dict(zip(ATTRIBUTES, tolerance, strict=True)),
    }


def coding_of(case: Case) -> Coding:
    """What a case says of its coding; only keyframes have a grid, whose unit their log-scales are coded in."""
    transform = unpack_transform(case["colour_transform"])
    unit = Grid(**case["grid"]).unit if "grid" in case else 1.0
    return Coding(case["steps"], case["factor"], case["gain"], transform, unit)


def unpack_transform(text: str) -> Floats:
    entries = np.frombuffer(data(text), "<i2") / 32767
    return entries.reshape(math.isqrt(len(entries)), -1)


def keyframes() -> Table:
    """Codes of a keyframe -> values of the canonical space, all but the means, which codes of keyframes do not have."""
    found = []
    for case in cases("keyframes"):
        codes = np.array(case["codes"], np.float64)
        parts = listed(keyframe_rows(codes, coding_of(case), np.zeros((codes.shape[1], 3))), limit=False)
        found.append(case | {name: {k: one for k, one in part.items() if k != "means"} for name, part in parts.items()})
    return {"cases": found}


def deltas() -> Table:
    """Codes of deltas, applied to a canonical space: the rows that a level carries, and every row in each frame."""
    found = []
    for case in cases("deltas"):
        depths = enumerate(case["canonical"]["depths"])
        rows = [row for row, depth in depths if case["level"] <= depth < STATIC]
        found.append(case | {"rows": rows, "frames": [_frame(case, rows, i) for i in range(len(case["frames"]))]})
    return {"cases": found}


def _frame(case: Case, carried: list[int], place: int) -> dict[str, Any]:
    space, codes, last = case["canonical"], case["frames"][place]["codes"], len(case["frames"]) - 1
    quaternions, alpha = np.array(space["quaternions"]), term(np.array(space["alpha"])[:, None])
    means, log_scales, colours = (term(space[name]) for name in ("means", "log_scales", "colours"))
    rows = Rows(means, quaternions, np.zeros((len(quaternions), 1)), log_scales, alpha, colours)
    summed = np.array(codes, np.float64)
    if "slopes" in case:
        summed = summed + (2 * place - last) / last * np.array(case["slopes"])
    changes = np.zeros((len(codes), len(quaternions)))
    changes[:, carried] = summed[:, : len(carried)]
    return {"codes": codes, **listed(delta_rows(rows, changes, coding_of(case), space["classes"]), limit=True)}


def basis(x: float, y: float, z: float) -> Floats:
    """(16,) The real spherical harmonics of bands 0 to 3, from their closed forms."""
    pi = math.pi
    one, two, three = math.sqrt(3 / (4 * pi)), math.sqrt(15 / (4 * pi)), math.sqrt(35 / (32 * pi))
    bands = [
        math.sqrt(1 / (4 * pi)),
        *(-one * y, one * z, -one * x),
        *(two * x * y, -two * y * z, math.sqrt(5 / (16 * pi)) * (2 * z * z - x * x - y * y)),
        *(-two * x * z, two / 2 * (x * x - y * y)),
        *(-three * y * (3 * x * x - y * y), math.sqrt(105 / (4 * pi)) * x * y * z),
        -math.sqrt(21 / (32 * pi)) * y * (4 * z * z - x * x - y * y),
        math.sqrt(7 / (16 * pi)) * z * (2 * z * z - 3 * x * x - 3 * y * y),
        -math.sqrt(21 / (32 * pi)) * x * (4 * z * z - x * x - y * y),
        *(math.sqrt(105 / (16 * pi)) * z * (x * x - y * y), -three * x * (x * x - 3 * y * y)),
    ]
    return np.array(bands)


def region() -> Table:
    """Regions with viewers: where they are, the unit vector along which they look, and how far they are outside."""
    return {"cases": [case | {"viewers": [_viewer(case, one) for one in case["viewers"]]} for case in cases("region")]}


def _viewer(case: Case, one: Case) -> Case:
    distance, degrees = departure(case, one["position"], one["forward"])
    degrees = 0.0 if degrees < 1e-4 else degrees  # rounding
    return one | {"distance": plain(distance), "degrees": plain(degrees), "inside": distance == 0 and degrees == 0}


def shown() -> Table:
    """Covariances of rows; colours of coefficients, r g b of each, from directions."""
    return {
        "covariances": [case | {"covariance": _covariance(case)} for case in cases("shown", "covariances")],
        "colours": [case | {"colour": _colour(case)} for case in cases("shown", "colours")],
    }


def _covariance(case: Case) -> Any:
    w, x, y, z = case["quaternion"]
    matrix = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    squares = [math.exp(2 * size) for size in case["log_scales"]]
    entries = [[[a * s * b for a, s, b in zip(i, squares, j, strict=True)] for j in matrix] for i in matrix]
    return plain([[math.fsum(terms) for terms in line] for line in entries])


def _colour(case: Case) -> Any:
    rows = np.array(case["coefficients"])
    return plain(np.maximum(0, 0.5 + basis(*case["direction"])[: len(rows)] @ rows).tolist())
