"""Codes of states, applied to a canonical space (FORMAT.md, sections 4 and 5)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tests.makers.vectors.formulas import Coding, Row, listed, pack_transform, rotation, state_row, total
from tests.makers.vectors.keys import COLOURS, Codes, by_channel, drawn, rotated
from tests.makers.vectors.text import Table, plain

STEPS = {"means": 0.0007, "quaternions": 0.03, "log_scales": 0.12, "opacity": 0.058, "sh_dc": 0.063, "sh_rest": 0.08}
STATIC = 255


@dataclass(frozen=True, slots=True)
class Space:
    rows: Sequence[Row]
    classes: Sequence[int]
    depths: Sequence[int]

    def carried(self, level: int) -> list[int]:
        return [i for i, depth in enumerate(self.depths) if level <= depth < STATIC]

    def first(self, count: int) -> Space:
        return Space(self.rows[:count], self.classes[:count], self.depths[:count])


def space(count: int, degree: int, rng: np.random.Generator) -> Space:
    """A canonical space of numbers that float32 holds exactly, but for its rotations."""

    def numbers(*shape: int, scale: float) -> list[Any]:
        return (np.round(rng.normal(0, scale, shape) * 64) / 64).tolist()

    turns = [replace(rotation(v), angle=0.0) for v in numbers(count, 3, scale=1.0)]  # they are given, not computed
    rows = [
        Row([total([v]) for v in mean], turn, [total([v]) for v in size], total([alpha]), [total([v]) for v in colour])
        for mean, turn, size, alpha, colour in zip(
            numbers(count, 3, scale=3.0),
            turns,
            numbers(count, 3, scale=2.0),
            np.abs(numbers(count, scale=0.4)).tolist(),
            numbers(count, COLOURS[degree], scale=0.5),
            strict=True,
        )
    ]
    return Space(rows, rng.integers(-6, 4, count).tolist(), rng.choice([0, 1, 2, STATIC], count).tolist())


@dataclass(frozen=True, slots=True)
class Case:
    name: str
    degree: int
    space: Space
    codes: Sequence[Codes]  # of each frame, one list a row of the atlas
    level: int = 0
    factor: float = 1.0
    slopes: Codes | None = None  # of a line in time

    def summed(self, frame: int) -> list[list[float]]:
        """The codes of a frame with what slopes add, one list a row of the atlas."""
        if self.slopes is None:
            return [list(row) for row in self.codes[frame]]
        time = (2 * frame - (len(self.codes) - 1)) / (len(self.codes) - 1)
        pairs = zip(self.codes[frame], self.slopes, strict=True)
        return [[c + time * s for c, s in zip(row, rise, strict=True)] for row, rise in pairs]


def cases(rng: np.random.Generator) -> list[Case]:
    out = []
    for degree, colours in enumerate(COLOURS):
        base = space(3 if degree == 3 else 5, degree, rng)
        codes = [drawn(len(base.carried(0)), 10 + colours, rng) for _ in range(2 if degree < 2 else 1)]
        out.append(Case(f"SH degree {degree}", degree, base, codes, factor=1.0 + 0.7 * degree))
    levels = replace(space(8, 0, rng), depths=[0, 2, STATIC, 1, 0, 2, 3, 254])
    for level in range(4):
        codes = [drawn(len(levels.carried(level)), 13, rng)]
        out.append(Case(f"which rows level {level} carries", 0, levels, codes, level))
    whole = [drawn(len(levels.carried(1)), 13, rng) for _ in range(2)]
    for count in (8, 5, 3, 1):
        out.append(Case(f"the key tiers of the first {count} of 8 rows", 0, levels.first(count), whole, 1))
    moved = _other_quality(levels, rng)
    out.append(Case("the key quality of the level", 0, levels, [whole[0]], 1))
    out.append(Case("another key quality", 0, moved, [whole[0]], 1))
    return [*out, *_edges(rng), *_lines(np.random.default_rng(41))]


def _other_quality(base: Space, rng: np.random.Generator) -> Space:
    """The same rows, decoded from a coarser key: other values, the same classes and depths."""
    other = space(len(base.rows), 0, rng)
    return replace(base, rows=[_nudge(a, b) for a, b in zip(base.rows, other.rows, strict=True)])


def _nudge(row: Row, by: Row) -> Row:
    means = [total([a.value + b.value / 64]) for a, b in zip(row.means, by.means, strict=True)]
    colours = [total([a.value + b.value / 16]) for a, b in zip(row.colours, by.colours, strict=True)]
    return Row(means, by.quaternions, by.log_scales, by.alpha, colours)


def _edges(rng: np.random.Generator) -> list[Case]:
    classes = [-128, -100, -24, -1, 0, 1, 20, 60, 100]
    moving = replace(space(len(classes), 0, rng), classes=classes, depths=[0] * len(classes))
    steps = [[[1000, -1, 7] + [0] * 10 for _ in classes]]
    alphas = [-0.125, 0.0, 0.0, 0.5, 0.5, 1.0, 1.125, 1.125, 0.25, 1.5]
    changes = [0, 0, 1, -100, 200, 0, 0, -100, -26, 0]
    faded = space(len(alphas), 0, rng)
    rows = [replace(row, alpha=total([alpha])) for row, alpha in zip(faded.rows, alphas, strict=True)]
    faded = replace(faded, rows=rows, depths=[0] * 9 + [STATIC])
    fade = [[[0] * 9 + [change] + [0] * 3 for change in changes[:9]]]
    turning = replace(space(5, 0, rng), depths=[0] * 5)
    turns = [[0, 0, 0], [628, 0, 0], [0, 0, -1257], [1, 1, 1], [300, -400, 2000]]
    still = space(4, 1, rng)
    return [
        Case("extreme motion classes", 0, moving, steps),
        Case("alpha leaves 0 to 1 and comes back", 0, faded, fade),
        Case("turns about 0, π, 2π and more", 0, turning, [[[0] * 6 + turn + [0] * 4 for turn in turns]]),
        Case("codes of 0", 1, still, [[[0] * 22 for _ in still.carried(0)]]),
        Case("a level that carries no row", 0, still_rows(rng), [[]]),
    ]


def _lines(rng: np.random.Generator) -> list[Case]:
    """Segments with slopes, of two frames and of more, whose frames are drawn apart from those of other cases."""
    out = []
    for frames in (2, 3):
        base = replace(space(2, 0, rng), depths=[0, 1])
        codes = [drawn(2, 13, rng) for _ in range(frames)]
        out.append(Case(f"a line over {frames} frames", 0, base, codes, slopes=drawn(2, 13, rng, 200.0)))
    return out


def still_rows(rng: np.random.Generator) -> Space:
    """Rows that no level carries, the alpha of one of them out of bounds."""
    base = space(3, 0, rng)
    faded = replace(base.rows[1], alpha=total([1.25]))
    return replace(base, rows=[base.rows[0], faded, base.rows[2]], depths=[STATIC] * 3)


def table() -> Table:
    rng = np.random.default_rng(11)
    return {"cases": [_case(case, rng) for case in cases(rng)]}


def _case(case: Case, rng: np.random.Generator) -> dict[str, Any]:
    text, transform = pack_transform(rotated(COLOURS[case.degree], rng))
    coding = Coding(STEPS, case.factor, 6.0, transform)
    return {
        "name": case.name,
        "sh_degree": case.degree,
        "steps": STEPS,
        "factor": case.factor,
        "gain": coding.gain,
        "colour_transform": text,
        "level": case.level,
        "canonical": _listed_space(case.space),
        "rows": case.space.carried(case.level),
        **({} if case.slopes is None else {"slopes": by_channel(case.slopes)}),
        "frames": [_frame(case, frame, coding) for frame in range(len(case.codes))],
    }


def _frame(case: Case, frame: int, coding: Coding) -> dict[str, Any]:
    shown = list(case.space.rows)
    for row, numbers in zip(case.space.carried(case.level), case.summed(frame), strict=False):
        shown[row] = state_row(shown[row], numbers, coding, case.space.classes[row])
    channels = by_channel(case.codes[frame]) or [[] for _ in range(10 + COLOURS[case.degree])]
    return {"codes": channels, **listed(shown, limit=True)}


def _listed_space(base: Space) -> dict[str, Any]:
    rows = base.rows
    return {
        "means": [[n.value for n in row.means] for row in rows],
        "quaternions": plain([row.quaternions.quaternion for row in rows]),
        "log_scales": [[n.value for n in row.log_scales] for row in rows],
        "alpha": [row.alpha.value for row in rows],
        "colours": [[n.value for n in row.colours] for row in rows],
        "classes": list(base.classes),
        "depths": list(base.depths),
    }
