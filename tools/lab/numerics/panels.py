"""The table of `work_precision`: its parts, and the panels of each: a question with what is good enough."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from airgs_codec.play.policies.named import DEFAULT_POLICY, ORACLES
from tools.lab.numerics import decode, encode, renderer, selector, survey, trainer
from tools.lab.numerics.rows import Bench, Point


@dataclass(frozen=True, slots=True)
class Panel:
    """A question that some rows answer."""

    name: str
    question: str
    unit: str  # of error
    time: str  # what the seconds are of
    enough: float | None  # as near to the best as this is good enough, in the unit; None: it decides nothing by itself
    default: tuple[str, str] = ("", "")  # curve and setting; nothing: it is not among those measured
    more: bool = False  # whether more of the unit is better
    log: bool = False  # axis of error
    last: bool = False  # only the last setting of each curve is judged: the others are other tasks
    curves: tuple[str, ...] = ()  # that are judged; nothing: all
    without: tuple[str, ...] = ()  # settings that nobody can choose
    labels: bool = True  # settings stand beside their points
    loose: tuple[str, ...] = ()  # curves whose points are not joined
    note: str = ""  # what the figures do not say


@dataclass(frozen=True, slots=True)
class Part:
    """Panels that are measured together."""

    name: str
    title: str
    measure: Callable[[Bench], Iterator[Point]]
    panels: tuple[Panel, ...]

    @property
    def picture(self) -> str:
        """The name of its picture."""
        return f"precision-{self.name}"


CPU = "CPU seconds"
WAITING = "Regret does not count waiting, so that neither a policy nor a horizon follows from it alone."
PARTS = (
    Part(
        "encode",
        "Encoding",
        encode.measure,
        (
            Panel(
                "presets", "Preset", encode.UNIT, CPU, 0.5, default=(encode.CALIBRATED, "veryslow")
            ),
        ),
    ),
    Part(
        "survey",
        "Looking",
        survey.measure,
        (
            Panel(
                "claims",
                "Pictures measured",
                survey.OFF,
                CPU,
                0.2,
                default=(survey.OWN, "5"),
                log=True,
                labels=False,
                loose=(survey.OWN,),
                note="The encoder's own claims are one trial each, and do not fall in order of their pictures.",
            ),
            Panel("deciding", "Pictures that decide", encode.UNIT, CPU, 0.3, default=("calibrated", "24")),
        ),
    ),
    Part(
        "decode",
        "Decoding",
        decode.measure,
        (
            Panel("rungs", "A cheaper rung", decode.UNIT, f"{CPU} a frame", 3.0, (decode.RUNGS, "L0"), more=True),
            Panel("stages", "Stages of the top rung", "", f"{CPU} a frame", 0.0),
        ),
    ),
    Part(
        "renderer",
        "Rendering",
        renderer.measure,
        (
            Panel("precision", "Precision", renderer.UNIT, f"{CPU} a picture", 1e-3, log=True, last=True, labels=False),
            Panel("tiles", "Tile size", renderer.UNIT, f"{CPU} a picture", 1e-3, log=True),
            Panel("cuts", "Cut-off of alpha", renderer.UNIT, f"{CPU} a picture", 1e-2, log=True),
        ),
    ),
    Part(
        "trainer",
        "Training",
        trainer.measure,
        (
            Panel("first", "First frame", trainer.UNIT, CPU, 0.6, more=True),
            Panel("views", "Views an iteration", trainer.UNIT, CPU, 0.6, more=True),
            Panel("frame", "Frame in a group", trainer.UNIT, CPU, 0.1, default=("direct", "300"), more=True),
        ),
    ),
    Part(
        "selector",
        "Choosing",
        selector.measure,
        (
            Panel("policies", "Policy", selector.UNIT, f"{CPU} a choice", None, note=WAITING),
            Panel("policies qoe", "Policy", selector.QOE, f"{CPU} a choice", 0.1, (DEFAULT_POLICY, DEFAULT_POLICY),
                  more=True, without=tuple(ORACLES)),
            Panel("horizon", "Segments ahead", selector.UNIT, f"{CPU} a choice", None),
            Panel("horizon qoe", "Segments ahead", selector.QOE, f"{CPU} a choice", 0.1, more=True,
                  curves=(selector.MPC,)),
            Panel("levels", "Levels of a ladder", selector.UNIT, f"{CPU} a frame", 0.1, log=True),
        ),
    ),
)  # fmt: skip
NAMES = tuple(part.name for part in PARTS)
