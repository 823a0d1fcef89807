"""Pictures -> codes: where rows lie in planes, and planes in pictures (FORMAT.md, section 4)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tests.makers.vectors.text import Table, binary, runs

LUMA = range(16, 236)
ROWS = (0, 1, 2, 3, 4, 15, 16, 85, 170, 255, 256, 257, 511, 512, 700, 1023, 1024)


@dataclass(frozen=True, slots=True)
class Layout:
    rows: int
    plane_width: int
    columns: int
    planes: tuple[int, ...]  # channels that have a plane
    channels: int
    picture: tuple[int, int]  # width and height in samples
    pages: int = 1


def cell(row: int, plane_width: int) -> tuple[int, int]:
    block, number = divmod(row, 256)
    column = sum(((number >> 2 * bit) & 1) << bit for bit in range(4))
    line = sum(((number >> 2 * bit + 1) & 1) << bit for bit in range(4))
    wide_blocks = plane_width // 16
    return block % wide_blocks * 16 + column, block // wide_blocks * 16 + line


def sample(layout: Layout, plane: int, row: int) -> tuple[int, int]:
    """Column and line of a sample in the picture, its pages one below another."""
    blocks = -(-layout.rows // 256)
    high = 16 * -(-blocks // (layout.plane_width // 16))
    column, line = cell(row, layout.plane_width)
    return plane % layout.columns * layout.plane_width + column, plane // layout.columns * high + line


LAYOUTS = {
    "one row, one plane": Layout(1, 16, 1, (2,), 4, (16, 16)),
    "no planes": Layout(3, 0, 0, (), 4, (0, 0)),
    "one block a plane": Layout(256, 16, 2, (0, 1, 3), 4, (48, 32)),
    "a row more than a block": Layout(257, 16, 2, (0, 2), 3, (32, 48)),
    "two blocks side by side": Layout(300, 32, 1, (1, 2), 3, (48, 32)),
    "planes three blocks wide, the last line of blocks not full": Layout(770, 48, 2, (0, 3, 4), 5, (96, 64)),
    "five planes in two lines": Layout(40, 16, 3, (0, 1, 2, 4, 5), 6, (64, 64)),
    "a plane across three pages, the last not full": Layout(1300, 16, 1, (1,), 2, (16, 32), 3),
    "two lines of planes, each across pages": Layout(700, 16, 2, (0, 1, 3), 4, (32, 64), 2),
}


def table() -> Table:
    rng = np.random.default_rng(4)
    widths = (16, 32, 48)
    places = [{"row": row, "plane_width": width, "place": cell(row, width)} for width in widths for row in ROWS]
    return {"places": places, "cases": [_case(name, layout, rng) for name, layout in LAYOUTS.items()]}


def _case(name: str, layout: Layout, rng: np.random.Generator) -> dict[str, Any]:
    width, height = layout.picture
    luma = rng.choice(LUMA, (layout.pages * height, width))
    centres = rng.integers(-300, 300, layout.channels).tolist()
    bases = rng.choice([0] * 40 + [-3, -1, 1, 2, 1000], (len(layout.planes), layout.rows)).tolist()
    codes = [[centre] * layout.rows for centre in centres]
    for plane, channel in enumerate(layout.planes):
        for row in range(layout.rows):
            column, line = sample(layout, plane, row)
            codes[channel][row] = int(luma[line, column]) - 128 + 128 * bases[plane][row] + centres[channel]
    return {
        "name": name,
        "rows": layout.rows,
        "plane_width": layout.plane_width,
        "columns": layout.columns,
        "planes": layout.planes,
        "centres": centres,
        "width": width,
        "height": height,
        "luma": binary(luma.astype(np.uint8).tobytes()),
        "bases": [runs(line) for line in bases],
        "codes": [runs(line) for line in codes],
    }
