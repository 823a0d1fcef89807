"""Whole numbers: column files, Morton codes, sidecars of positions, escapes and samples of pictures.

FORMAT.md, sections 7, 3, 6 and 4. Files are written by the encoder; refused are columns that it would not write.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from airgs_codec.coding.rangecoder import encode_columns
from airgs_codec.coding.sidecar import KeyframeSidecar, detail_columns, pack_keyframe_sidecar
from tests.faces import Grid
from tests.support.vectors import Case, Table, binary, cases, data, numbers, runs, wide

Columns = Sequence[tuple[Sequence[int], int]]  # numbers and the order that they are coded in
ANY = Grid([0, 0, 0], 1.0, 0)
BROKEN_DEPTHS = {"a depth of 255 and one": [[0, 256]], "a depth too few": [[1]], "another column": [[0, 1], [128]]}
BROKEN_ESCAPES = {  # each has two frames of one plane of three rows, six samples
    "more jumps than samples": (7, [0, 1, 1, 1, 1, 1, 1], [2] * 7),
    "very many jumps": (2**62, [], []),
    "two jumps of one sample": (2, [1, 0], [2, 2]),
    "a jump after the last sample": (2, [5, 1], [2, 2]),
    "a gap of 63 bits": (2, [0, 2**63 - 1], [2, 2]),
    "a jump of 32 bits": (1, [0], [2**32]),
    "fewer jumps than it says": (3, [0, 1], [2, 2]),
}


def _coded(*columns: tuple[Sequence[int], int]) -> str:
    return binary(encode_columns([(np.array(values, np.int64), order) for values, order in columns]))


def columns() -> Table:
    """Cases to read, and cases to refuse as bad_sidecar while or after reading columns of those lengths."""
    coded = [_coded(*((numbers(one["numbers"]), one["order"]) for one in case["columns"])) for case in cases("columns")]
    found = [one | {"data": text} for one, text in zip(cases("columns"), coded, strict=True)]
    whole = encode_columns([(np.arange(50), 0)])
    broken = {
        "no bytes": b"",
        "four bytes": bytes(4),
        "the last byte is missing": whole[:-1],
        "half of the file is missing": whole[: len(whole) // 2],
        "a byte of 0 too many": whole + b"\0",
        "a byte too many": whole + b"\7",
        "the first byte is 1": b"\1" + whole[1:],
        "x is not 0 at the end": whole[:-1] + bytes([whole[-1] ^ 1]),
        "fewer numbers are asked for than are there": whole,
    }
    refused = [
        {"name": name, "data": binary(file), "columns": [{"order": 0, "count": 40 if file == whole else 50}]}
        for name, file in broken.items()
    ]
    return {"cases": found, "refused": refused}


def escapes() -> Table:
    """Segments with the bases of every frame, and columns that must be refused."""
    size = {"frames": 2, "planes": 1, "rows": 3}
    refused = [{"name": name, **size, "data": _escapes(*parts)} for name, parts in BROKEN_ESCAPES.items()]
    return {"cases": [case | {"data": _jumps(case)} for case in cases("escapes")], "refused": refused}


def _jumps(case: Case) -> str:
    """The jumps that make the bases of a case, which are 0 before its first frame."""
    frames = [[number for line in frame for number in numbers(line)] for frame in case["bases"]]
    before = [[0] * len(frames[0]), *frames]
    jumps = [b - a for one, other in zip(before, frames, strict=False) for a, b in zip(one, other, strict=True)]
    index = [place for place, jump in enumerate(jumps) if jump]
    zigzag = [2 * jump if jump >= 0 else -2 * jump - 1 for jump in jumps if jump]
    return _escapes(len(index), [b - a for a, b in zip([0, *index], index, strict=False)], zigzag)


def _escapes(count: int, gaps: list[int], zigzag: list[int]) -> str:
    return _coded(([count], 0), (gaps, 0), (zigzag, 1))


def planes() -> Table:
    """Pictures -> codes: where rows lie in planes, and planes in pictures."""
    places = [one | {"place": cell(one["row"], one["plane_width"])} for one in cases("planes", "places")]
    return {"places": places, "cases": [case | {"codes": _codes(case)} for case in cases("planes")]}


def cell(row: int, plane_width: int) -> tuple[int, int]:
    block, number = divmod(row, 256)
    column = sum(((number >> 2 * bit) & 1) << bit for bit in range(4))
    line = sum(((number >> 2 * bit + 1) & 1) << bit for bit in range(4))
    wide_blocks = plane_width // 16
    return block % wide_blocks * 16 + column, block // wide_blocks * 16 + line


def _codes(case: Case) -> list[list[int]]:
    """What the luma, the bases and the centres of a case say, by channel; pages lie one below another."""
    luma, codes = data(case["luma"]), [[centre] * case["rows"] for centre in case["centres"]]
    stride, blocks = case["plane_width"], -(-case["rows"] // 256)
    for plane, (channel, bases) in enumerate(zip(case["planes"], case["bases"], strict=True)):
        high = 16 * -(-blocks // (stride // 16))
        left, top = plane % case["columns"] * stride, plane // case["columns"] * high
        for row, base in enumerate(numbers(bases)):
            column, line = cell(row, stride)
            codes[channel][row] += luma[(top + line) * case["width"] + left + column] - 128 + 128 * base
    return [runs(line) for line in codes]


def positions() -> Table:
    """Morton codes; tiers with the files of each quality; sidecars and details that must be refused."""
    inter = [case | {"data": _packed(_sidecar([], [], [], case["depths"]))} for case in cases("positions", "inter")]
    return {
        "morton": [case | {"code": str(interleave(case["index"]))} for case in cases("positions", "morton")],
        "tiers": [_tier(case) for case in cases("positions", "tiers")],
        "refused": _refused(),
        "inter": inter,
        "inter_refused": [
            {"name": name, "rows": 2, "data": _coded(*((one, 1) for one in columns))}
            for name, columns in BROKEN_DEPTHS.items()
        ],
    }


def interleave(index: Sequence[int]) -> int:
    return sum(((index[axis] >> bit) & 1) << (3 * bit + axis) for bit in range(21) for axis in range(3))


def parted(code: int) -> list[int]:
    return [sum(((code >> 3 * bit + axis) & 1) << bit for bit in range(21)) for axis in range(3)]


def _sidecar(codes: list[int], classes: list[int], wider: list[int], depths: list[int]) -> KeyframeSidecar:
    own, e = (np.array(values, np.int16) for values in (classes, wider))
    return KeyframeSidecar(np.array(codes, np.uint64), own, e, np.array(depths, np.uint8))


def _packed(sidecar: KeyframeSidecar, grid: Grid = ANY, coarsest: int = 0) -> str:
    return binary(pack_keyframe_sidecar(sidecar, grid, coarsest))


def _tier(case: Case) -> Case:
    """A tier, whose cells in Q0, classes, depths and grids are given, with its files and its cells in all qualities."""
    grid, qualities = Grid(**case["grid"]), case["qualities"]
    codes, last = numbers(qualities[0]["codes"]), qualities[-1]["coarser"]
    sidecar = _sidecar(codes, case["classes"], case["wider"], case["depths"])
    made = [_quality(case, [parted(code) for code in codes], quality["coarser"]) for quality in qualities]
    for quality in made:
        detail = [*detail_columns(sidecar, grid, quality["coarser"], last), (np.zeros(1, np.int64), 0)]
        quality["data"] = binary(encode_columns(detail))
    return case | {"data": _packed(sidecar, grid, last), "qualities": made}


def _quality(case: Case, fine: Sequence[Sequence[int]], coarser: int) -> Case:
    """Cells that are 2^b steps of the grid of their row wide, and their middles."""
    cells, means, grid = [], [], Grid(**case["grid"])
    for index, motion, e in zip(fine, case["classes"], case["wider"], strict=True):
        b = min(min(max(motion - e - grid.finest, 0), 21) + coarser, 21)
        cells.append([number >> b << b for number in index])
        away = [(number + 2**b / 2 - 2**20) * 2**e for number in cells[-1]]
        means.append([grid.step * (start + 2**20 + steps) for start, steps in zip(grid.origin, away, strict=True)])
    return {"coarser": coarser, "data": "", "codes": wide([interleave(cell) for cell in cells]), "means": means}


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
    given = {"grid": asdict(ANY), "rows": 2, "coarsest": 2}
    return [
        {"name": name, **given, "data": _coded(*columns), "coarser": 0,
         "detail": _coded((detail[:1], 0), (detail[1:], 0), ([0], 0))}
        for name, columns, detail in broken
    ]  # fmt: skip
