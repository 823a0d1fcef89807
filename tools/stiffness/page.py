"""The page: a sentence of conclusion for every sweep, computed from its cells, and its regions."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from tools.stiffness.outcome import CONVERGES, FAULTS, Cell, Region, Sweep, count_ends, number, regions, span

INTRODUCTION = """# Stiff and extreme cases

Where the numbers of the trainer, the codec and the selector are at their ends, every region ends in one of three ways:
it converges, is bounded by something that is named, or is refused with a message. This page is written by
`python -m tools.stiff -o OUT`, its sentences are computed from what was measured. [numerics.md](numerics.md) says
which bounds hold, [extremes.md](extremes.md) has whole sequences at the ends of float32.

In the maps a field is one experiment, with what was measured in it. Fields are coloured by how they end:

- **converges**: a fit at least halves its loss; a gradient is within 1e-3 of float64; steps are those of the optimum;
  a plan is feasible and its relaxation no more than 0.01 dB better; a session does not stall.
- **is bounded**: what comes is finite and feasible, but a limit decides it.
- **is refused**: an error of one line.
- **diverges**, **is not finite**: a loss over that at the start, a step without limit, a plan that does not fit, NaN.
"""

ABOUT = {
    "trainer": """## Trainer

Scenes of 6 to 12 Gaussians, two pictures of 32 x 32, 30 iterations of the trainer's own loop and loss. Rows are factors
on the trainer's learning rates, of which 1 is what it uses. Panels are the trainer's Adam and three ways to step that
were rejected: Adam with the usual epsilon of 1e-8, gradient descent with a unit for each attribute, and with one unit
for all. Their units make a first step as long as Adam's for round Gaussians in the middle of the scene.
""",
    "gradients": """## Gradients

The CPU kernels, which sum pixels in float32, against automatic differentiation of the renderer's definition in float64
(`airgs_codec/render/reference.py`), for the same scenes at the start of their fits: the median over three random
derivatives of the picture and two cameras.
""",
    "codec": """## Codec

Scenes of 256 Gaussians and 4 frames. Calibration and steps are measured with the trial encodes of the encoder: real
H.264 pictures, which are decoded. Whole packages are in [extremes.md](extremes.md).
""",
    "selector": """## Selector

Plans over 8 segments of 4 levels, and sessions of 30 loops over the package manifests/valid/moving. The relaxation of
a plan is a linear programme, the plan itself an integer one, both solved with HiGHS.
""",
}


def write_page(parts: Mapping[str, Sequence[Sweep]], pictures: Mapping[str, str], run: str) -> str:
    """Markdown; `pictures`: file names of maps by part or by sweep, `run`: how it was made, a sentence."""
    text = [INTRODUCTION, f"{run}\n", _summary([s for sweeps in parts.values() for s in sweeps])]
    for name, sweeps in parts.items():
        text.append(ABOUT[name] + _picture(pictures.get(name), f"How the cells of the {name} end"))
        text += [_section(sweep, pictures.get(sweep.name)) for sweep in sweeps]
    return "\n".join(text)


def _summary(sweeps: Sequence[Sweep]) -> str:
    own = [cell for sweep in sweeps for cell in sweep.shipped]
    wrong = [cell for cell in own if cell.end in FAULTS]
    words = ", ".join(f"{count} {_plural(end)}" for end, count in count_ends(own).items())
    faults = f"{len(wrong)} are faults" if wrong else "none is a fault"
    return f"Of {len(own)} experiments with the code as it is, {words}; {faults}.\n"


def _plural(end: str) -> str:
    return {"converges": "converge", "diverges": "diverge"}.get(end, end.replace("is ", "are ", 1))


def _picture(path: str | None, words: str) -> str:
    return f"\n![{words}]({path})\n" if path else ""


def _section(sweep: Sweep, picture: str | None) -> str:
    lines = [f"### {sweep.title}\n", f"{conclusion(sweep)} What the code does: {sweep.does}.\n"]
    lines += [_picture(picture, f"How the cells of {sweep.title} end").lstrip("\n")] * bool(picture)
    lines += ["| " + " | ".join(("where", sweep.x_label or "scene", "ends", sweep.value_label, "words")) + " |"]
    lines += ["|---|---|---|---|---|"]
    lines += [_row(sweep, region) for region in regions(sweep)]
    return "\n".join(lines) + "\n"


def _row(sweep: Sweep, region: Region) -> str:
    where = span(region.first, region.last) if sweep.x_label else ""
    row = "" if sweep.own[1] else region.row
    return f"| {row} | {where} | {region.end} | {_values(region.cells)} | {region.notes} |"


def _values(cells: Sequence[Cell]) -> str:
    known = [cell.value for cell in cells if not math.isnan(cell.value)]
    return span(min(known), max(known)) if known else ""


def conclusion(sweep: Sweep) -> str:
    """One sentence: how the code as it is ends along the sweep, and how the other panels do."""
    own = sweep.shipped
    ends = []
    for end, count in count_ends(own).items():
        some = [cell for cell in own if cell.end == end]
        where = f" ({sweep.x_label} {_ranges(sweep, end)})" if sweep.x_label and sweep.own[1] else ""
        worst = [cell.value for cell in some if math.isfinite(cell.value)]
        measured = f", {sweep.value_label} at most {number(max(worst))}" if worst else ""
        ends.append(f"{count} of {len(own)} {_plural(end)}{where}{measured}")
    others = [panel for panel in dict.fromkeys(cell.panel for cell in sweep.cells) if panel != sweep.own[0]]
    rest = [_other(sweep, panel) for panel in others if sweep.own[0]]
    return "; ".join([", ".join(ends), *rest]) + "."


def _ranges(sweep: Sweep, end: str) -> str:
    return ", ".join(span(region.first, region.last) for region in regions(sweep) if region.end == end)


def _other(sweep: Sweep, panel: str) -> str:
    """How many cells of a panel converge, and how many of the same rows and columns do with the code as it is."""
    theirs = [cell for cell in sweep.cells if cell.panel == panel]
    ours = [cell for cell in sweep.cells if cell.panel == sweep.own[0]]
    counts = [sum(cell.end == CONVERGES for cell in cells) for cells in (theirs, ours)]
    words = [f"{counts[0]} of {len(theirs)} fields of “{panel}” converge"]
    words += [f"{count} {_plural(end)}" for end, count in count_ends(theirs).items() if end in FAULTS]
    return f"{', '.join(words)} (against {counts[1]} of {len(ours)} of “{sweep.own[0]}”)"
