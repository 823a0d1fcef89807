"""Pictures -> codes: where rows lie in planes, and planes in pictures (FORMAT.md, section 4)."""

from __future__ import annotations

import base64

from tests.makers.vectors.text import Table, runs
from tests.support.vectors import Case, cases, numbers


def cell(row: int, plane_width: int) -> tuple[int, int]:
    block, number = divmod(row, 256)
    column = sum(((number >> 2 * bit) & 1) << bit for bit in range(4))
    line = sum(((number >> 2 * bit + 1) & 1) << bit for bit in range(4))
    wide_blocks = plane_width // 16
    return block % wide_blocks * 16 + column, block // wide_blocks * 16 + line


def sample(case: Case, plane: int, row: int) -> tuple[int, int]:
    """Column and line of a sample in the picture, its pages one below another."""
    blocks = -(-case["rows"] // 256)
    high = 16 * -(-blocks // (case["plane_width"] // 16))
    column, line = cell(row, case["plane_width"])
    return plane % case["columns"] * case["plane_width"] + column, plane // case["columns"] * high + line


def table() -> Table:
    places = [one | {"place": cell(one["row"], one["plane_width"])} for one in cases("planes", "places")]
    return {"places": places, "cases": [case | {"codes": _codes(case)} for case in cases("planes")]}


def _codes(case: Case) -> list[list[int]]:
    """What the luma, the bases and the centres of a case say, by channel."""
    luma, codes = base64.b64decode(case["luma"]), [[centre] * case["rows"] for centre in case["centres"]]
    for plane, (channel, bases) in enumerate(zip(case["planes"], case["bases"], strict=True)):
        for row, base in enumerate(numbers(bases)):
            column, line = sample(case, plane, row)
            codes[channel][row] += luma[line * case["width"] + column] - 128 + 128 * base
    return [runs(line) for line in codes]
