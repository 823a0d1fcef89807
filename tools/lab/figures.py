"""Which command makes which figure of which document. A test holds that nothing is left out, and all is there."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Figure:
    """A picture, a CSV or the tables of a document."""

    file: str  # below docs/; of tables the document itself
    document: str
    command: str


def _of(document: str, command: str, *files: str) -> tuple[Figure, ...]:
    return tuple(Figure(file, document, command) for file in files or (document,))


FIGURES = (
    *_of("README.md", "python -m tools.screenshot fox.airgs -o docs/browser.png", "docs/browser.png"),
    *_of("docs/datapath.svg", "(drawn by hand)"),
    *_of("docs/encoding.md", "airgs-manifest inspect fox.airgs --plot docs/ladder.png", "docs/ladder.png"),
    *_of("docs/playing.md", "python -m tools.make_film", "docs/session.gif"),
    *_of("docs/results/training.md", "airgs-train fox/ -o OUT --report OUT", "docs/results/training.png"),
    *_of("docs/results/crowd.md", "python -m tools.lab crowd fox.airgs raca2018_4g_car/ -o docs/results",
         *(f"docs/results/crowd-{name}.png" for name in ("cache", "egress", "policies", "stalls"))),
    *_of("docs/results/crowd.md", "python -m tools.lab soak-live -o docs/results", "docs/results/soak.png"),
    *_of("docs/results/time.md", "python -m tools.lab scale -o docs/results", "docs/results/scale-time.csv"),
    *_of("docs/results/numerics.md", "python -m tests.makers.extremes", "docs/results/extremes.csv"),
    *_of("docs/results/paper.md", "python -m tools.lab reproduce -o OUT",
         *(f"docs/results/paper-{name}" for name in
           ("quality.png", "ablations.png", "methods.csv", "streams.csv", "ablations.csv"))),
    *_of("docs/results/work_precision.md", "python -m tools.lab work-precision -o OUT",
         "docs/results/work_precision.csv",
         *(f"docs/results/precision-{name}.png"
           for name in ("decode", "encode", "renderer", "selector", "survey", "trainer"))),
    *_of("docs/results/stiff.md", "python -m tools.lab stiff -o OUT", "docs/results/stiff.csv",
         *(f"docs/results/stiff-{name}.png" for name in ("trainer", "gradients", "codec", "selector"))),
)  # fmt: skip
