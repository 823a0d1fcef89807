"""Morton codes, key sidecars and the detail of positions (FORMAT.md, section 3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from airgs_codec.coding.rangecoder import encode_columns
from airgs_codec.coding.sidecar import KeySidecar, detail_columns, pack_key_sidecar
from airgs_codec.package.tables import Grid
from tests.makers.vectors.text import Table, binary, wide

Index = tuple[int, int, int]
STATIC = 255
MOST = 2**21 - 1


@dataclass(frozen=True, slots=True)
class Tier:
    """The rows of a tier, in any order, and the key qualities that they are coded in."""

    name: str
    grid: Grid
    coarser: Sequence[int]  # of each key quality
    indices: Sequence[Index]  # grid indices in the cells of Q0; the low bits that a cell has are cut off
    classes: Sequence[int]
    depths: Sequence[int]
    wider: Sequence[int] = ()  # e of the grid of each row; empty: all 0

    def width(self, row: int, coarser: int) -> int:
        """The b of a row: its cell is 2^b steps of its grid wide."""
        k = min(max(self.classes[row] - self.e(row) - self.grid.finest, 0), 21)
        return min(k + coarser, 21)

    def e(self, row: int) -> int:
        return self.wider[row] if self.wider else 0


def interleave(index: Sequence[int]) -> int:
    return sum(((index[axis] >> bit) & 1) << (3 * bit + axis) for bit in range(21) for axis in range(3))


def corner(index: Sequence[int], width: int) -> list[int]:
    """The grid index at which the cell of `width` bits about an index begins."""
    return [number >> width << width for number in index]


def tiers() -> list[Tier]:
    rng = np.random.default_rng(3)

    def drawn(name: str, count: int, grid: Grid, coarser: Sequence[int]) -> Tier:
        indices = [(int(x), int(y), int(z)) for x, y, z in rng.integers(0, 2**13, (count, 3))]
        classes = rng.integers(grid.finest - 2, grid.finest + 4, count).tolist()
        depths = rng.choice([0, 1, 2, STATIC], count).tolist()
        return Tier(name, grid, coarser, indices, classes, depths)

    pair: Sequence[Index] = [(3, 5, 6), (3, 5, 6)]
    corners: Sequence[Index] = [(0, 0, 0), (MOST, MOST, MOST), (MOST, 0, 0), (0, 0, MOST)]
    return [
        Tier("one row", Grid([0, 0, 0], 1.0, 0), [0], [(1, 0, 1)], [0], [0]),
        Tier("two rows in one cell", Grid([-12, 2, 24], 0.125, -4), [0, 0], pair, [-4, -4], [0, 63]),
        Tier("corners of the grid", Grid([0] * 3, 2.0**-10, 2), [0, 1], corners, [2, 2, 1, -7], [0] * 4),
        Tier("cells of every width", Grid([0] * 3, 1.0, 0), [0, 2], [(MOST,) * 3] * 24, range(24), [1] * 24),
        Tier("cells as wide as the grid", Grid([14, 16, 18], 0.5, 4), [0, 21], pair, [127, 25], [0, 0]),
        Tier("extreme classes", Grid([0] * 3, 0.01, -128), [0, 3], [(9, 8, 7)] * 3, [-128, 127, -126], [0] * 3),
        Tier("all rows static", Grid([0] * 3, 0.1, 0), [0], [(1, 2, 3), (7, 7, 7)], [1, 0], [STATIC, STATIC]),
        Tier("wider grids", Grid([-(2**20)] * 3, 0.001, 0), [0, 1], corners, [0, 5, 7, 9], [0] * 4, [0, 1, 7, 40]),
        drawn("one quality", 40, Grid([-2473, 990, 5935], 0.0005055, -6), [0]),
        drawn("three qualities", 60, Grid([-226, 33, 4033], 0.0031, -3), [0, 2, 5]),
        drawn("qualities with equal cells", 30, Grid([58823, -58824, 0], 0.017, 0), [0, 1, 1]),
    ]


def table() -> Table:
    """Morton codes; tiers with the files of each quality; sidecars and details that must be refused."""
    indices = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (5, 3, 6), (MOST, 0, 0), (0, MOST, 0), (MOST,) * 3]
    morton = [{"index": list(index), "code": str(interleave(index))} for index in indices]
    return {
        "morton": morton,
        "tiers": [_case(tier) for tier in tiers()],
        "refused": _refused(),
        "kept": _kept(),
        "kept_refused": _kept_refused(),
    }


def _case(tier: Tier) -> dict[str, Any]:
    fine = [corner(index, tier.width(row, 0)) for row, index in enumerate(tier.indices)]
    order = sorted(range(len(fine)), key=lambda row: interleave(fine[row]))
    classes = [tier.classes[row] for row in order]
    depths = [tier.depths[row] for row in order]
    wider = [tier.e(row) for row in order]
    sidecar = _sidecar([interleave(fine[row]) for row in order], classes, depths, wider)
    qualities = []
    for coarser in tier.coarser:
        widths = [tier.width(row, coarser) for row in order]
        cells = [corner(fine[row], width) for row, width in zip(order, widths, strict=True)]
        places = zip(cells, widths, wider, strict=True)
        detail = [*detail_columns(sidecar, tier.grid, coarser, tier.coarser[-1]), (np.zeros(1, np.int64), 0)]
        qualities.append(
            {
                "coarser": coarser,
                "data": binary(encode_columns(detail)),
                "codes": wide([interleave(cell) for cell in cells]),
                "means": [_mean(tier.grid, *place) for place in places],
            }
        )
    return {
        "name": tier.name,
        "grid": asdict(tier.grid),
        "rows": len(order),
        "data": binary(pack_key_sidecar(sidecar, tier.grid, tier.coarser[-1])),
        "classes": classes,
        "depths": depths,
        "wider": wider,
        "qualities": qualities,
    }


def _mean(grid: Grid, cell: Sequence[int], width: int, e: int) -> list[float]:
    away = [(index + 2**width / 2 - 2**20) * 2**e for index in cell]
    return [grid.step * (start + 2**20 + steps) for start, steps in zip(grid.origin, away, strict=True)]


def _sidecar(
    codes: Sequence[int], classes: Sequence[int], depths: Sequence[int], wider: Sequence[int] = ()
) -> KeySidecar:
    own, e = (np.array(values, np.int16) for values in (classes, wider))
    return KeySidecar(np.array(codes, np.uint64), own, e, np.array(depths, np.uint8))


def _refused() -> list[dict[str, Any]]:
    grid = asdict(ANY)

    def case(name: str, columns: list[tuple[list[int], int]], detail: list[int] | None = None) -> dict[str, Any]:
        """Two rows, in a quality 2 finer than the last one."""
        data = binary(encode_columns([(np.array(v, np.int64), o) for v, o in columns]))
        added = binary(encode_columns([(np.array(v, np.int64), 0) for v in (detail or [0, 0], [0])]))
        return {"name": name, "grid": grid, "rows": 2, "coarsest": 2, "data": data, "coarser": 0, "detail": added}

    none: list[tuple[list[int], int]] = [([0], 0), ([], 0), ([], 1)]
    good: list[tuple[list[int], int]] = [([128], 0), ([0, 3], 1), ([0, 0], 0), ([1, 1], 1), *none]
    return [
        case("a class of 128", [([255], 0), ([0, 1], 1), *good[2:]]),
        case("a depth of 255 and one", [*good[:3], ([1, 256], 1), *none]),
        case("a code of 63 bits and one", [*good[:2], ([2**57, 0], 0), *good[3:]]),
        case("codes of 63 bits that add up to more", [*good[:2], ([2**57 - 1, 1], 0), *good[3:]]),
        case("a gap of 63 bits", [*good[:2], ([2**63 - 1, 0], 0), *good[3:]]),
        case("a grid 2^256 times as wide", [*good[:4], ([1], 0), ([1], 0), ([512], 1)]),
        case("a grid half as wide", [*good[:4], ([1], 0), ([1], 0), ([1], 1)]),
        case("three wider rows", [*good[:4], ([3], 0), ([0, 1, 1], 0), ([2, 2, 2], 1)]),
        case("a detail that leaves its cell", good, [64, 0]),
        case("a detail that leaves the cell of a row with a large cell", [good[0], ([0, 20], 1), *good[2:]], [0, 8]),
        case("a detail of 63 bits", good, [7, 2**62]),
    ]


def _kept() -> list[dict[str, Any]]:
    cases = [("one row", [STATIC]), ("three rows", [STATIC, 0, 254]), ("many rows", [i % 5 for i in range(40)])]
    return [
        {"name": name, "rows": len(d), "data": binary(pack_key_sidecar(_sidecar([], [], d), ANY)), "depths": d}
        for name, d in cases
    ]


def _kept_refused() -> list[dict[str, Any]]:
    def case(name: str, *columns: list[int]) -> dict[str, Any]:
        return {"name": name, "rows": 2, "data": binary(encode_columns([(np.array(v, np.int64), 1) for v in columns]))}

    return [
        case("a depth of 255 and one", [0, 256]),
        case("a depth too few", [1]),
        case("another column", [0, 1], [128]),
    ]


ANY = Grid([0, 0, 0], 1.0, 0)
