"""Morton codes, key sidecars and the detail of positions (FORMAT.md, section 3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from airgs_codec.coding.rangecoder import encode_columns
from airgs_codec.coding.sidecar import KeySidecar, detail_columns, pack_key_sidecar
from tests.faces import Grid
from tests.makers.vectors.text import Table, binary, wide
from tests.support.vectors import Case, cases, numbers

ANY = Grid([0, 0, 0], 1.0, 0)
Columns = Sequence[tuple[Sequence[int], int]]  # numbers and the order that they are coded in


def interleave(index: Sequence[int]) -> int:
    return sum(((index[axis] >> bit) & 1) << (3 * bit + axis) for bit in range(21) for axis in range(3))


def parted(code: int) -> list[int]:
    """The index that a code interleaves."""
    return [sum(((code >> 3 * bit + axis) & 1) << bit for bit in range(21)) for axis in range(3)]


def table() -> Table:
    """Morton codes; tiers with the files of each quality; sidecars and details that must be refused."""
    kept = cases("positions", "kept")
    packed = [binary(pack_key_sidecar(_sidecar([], [], [], case["depths"]), ANY)) for case in kept]
    return {
        "morton": [case | {"code": str(interleave(case["index"]))} for case in cases("positions", "morton")],
        "tiers": [_made(case) for case in cases("positions", "tiers")],
        "refused": _refused(),
        "kept": [case | {"data": data} for case, data in zip(kept, packed, strict=True)],
        "kept_refused": _kept_refused(),
    }


def _sidecar(codes: list[int], classes: list[int], wider: list[int], depths: list[int]) -> KeySidecar:
    own, e = (np.array(values, np.int16) for values in (classes, wider))
    return KeySidecar(np.array(codes, np.uint64), own, e, np.array(depths, np.uint8))


def _made(case: Case) -> Case:
    """A tier, whose cells in Q0, classes, depths and grids are given, with its files and its cells in all qualities."""
    grid, qualities = Grid(**case["grid"]), case["qualities"]
    codes, last = numbers(qualities[0]["codes"]), qualities[-1]["coarser"]
    sidecar = _sidecar(codes, case["classes"], case["wider"], case["depths"])
    made = [_quality(case, [parted(code) for code in codes], quality["coarser"]) for quality in qualities]
    for quality in made:
        detail = [*detail_columns(sidecar, grid, quality["coarser"], last), (np.zeros(1, np.int64), 0)]
        quality["data"] = binary(encode_columns(detail))
    return case | {"data": binary(pack_key_sidecar(sidecar, grid, last)), "qualities": made}


def _quality(case: Case, fine: Sequence[Sequence[int]], coarser: int) -> Case:
    """Cells that are 2^b steps of the grid of their row wide, and their middles."""
    cells, means, grid = [], [], Grid(**case["grid"])
    for index, motion, e in zip(fine, case["classes"], case["wider"], strict=True):
        b = min(min(max(motion - e - grid.finest, 0), 21) + coarser, 21)
        cells.append([number >> b << b for number in index])
        away = [(number + 2**b / 2 - 2**20) * 2**e for number in cells[-1]]
        means.append([grid.step * (start + 2**20 + steps) for start, steps in zip(grid.origin, away, strict=True)])
    return {"coarser": coarser, "data": "", "codes": wide([interleave(cell) for cell in cells]), "means": means}


def _coded(*columns: tuple[Sequence[int], int]) -> str:
    return binary(encode_columns([(np.array(values, np.int64), order) for values, order in columns]))


def _refused() -> list[Case]:
    """Two rows each, in a quality 2 finer than the last one; a name, the sidecar, and the columns of the detail."""
    none: Columns = [([0], 0), ([], 0), ([], 1)]
    good: Columns = [([2, 128], 0), ([0, 3], 1), ([0, 0], 0), ([1, 1], 1), *none]
    broken: list[tuple[str, Columns, list[int]]] = [
        ("a class of 128", [([2, 255], 0), ([0, 1], 1), *good[2:]], [0, 0, 0]),
        ("a depth of 255 and one", [*good[:3], ([1, 256], 1), *none], [0, 0, 0]),
        ("a code of 63 bits and one", [*good[:2], ([2**57, 0], 0), *good[3:]], [0, 0, 0]),
        ("codes of 63 bits that add up to more", [*good[:2], ([2**57 - 1, 1], 0), *good[3:]], [0, 0, 0]),
        ("a gap of 63 bits", [*good[:2], ([2**63 - 1, 0], 0), *good[3:]], [0, 0, 0]),
        ("cells of another quality", [([1, 128], 0), *good[1:]], [0, 0, 0]),
        ("the detail of another quality", good, [1, 0, 0]),
        ("a grid 2^256 times as wide", [*good[:4], ([1], 0), ([1], 0), ([512], 1)], [0, 0, 0]),
        ("a grid half as wide", [*good[:4], ([1], 0), ([1], 0), ([1], 1)], [0, 0, 0]),
        ("three wider rows", [*good[:4], ([3], 0), ([0, 1, 1], 0), ([2, 2, 2], 1)], [0, 0, 0]),
        ("a detail that leaves its cell", good, [0, 64, 0]),
        ("a detail that leaves the cell of a row with a large cell", [good[0], ([0, 20], 1), *good[2:]], [0, 0, 8]),
        ("a detail of 63 bits", good, [0, 7, 2**62]),
    ]
    size = {"grid": asdict(ANY), "rows": 2, "coarsest": 2}
    return [
        {
            "name": name,
            **size,
            "data": _coded(*columns),
            "coarser": 0,
            "detail": _coded((detail[:1], 0), (detail[1:], 0), ([0], 0)),
        }
        for name, columns, detail in broken
    ]


def _kept_refused() -> list[Case]:
    broken = {
        "a depth of 255 and one": [[0, 256]],
        "a depth too few": [[1]],
        "another column": [[0, 1], [128]],
    }
    return [{"name": name, "rows": 2, "data": _coded(*((one, 1) for one in c))} for name, c in broken.items()]
