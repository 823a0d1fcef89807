"""The table of `work_precision`: its questions, and what is good enough as an answer."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from airgs_codec.play.policies.mpc import HORIZON_SEGMENTS
from airgs_codec.play.policies.named import DEFAULT_POLICY, ORACLES
from tools.lab.numerics import decode, encode, renderer, selector, survey, trainer
from tools.lab.numerics.rows import Bench, Point


@dataclass(frozen=True, slots=True)
class Question:
    name: str  # in rows, and of its picture
    text: str
    measure: Callable[[Bench], Iterator[Point]]
    unit: str  # of error; its first word is that of a difference
    time: str  # what the seconds are of
    enough: float  # as near to the best as this is good enough, in the unit
    default: tuple[str, str] = ("", "")  # curve and setting; nothing: it is not among those measured
    more: bool = False  # whether more of the unit is better
    log: bool = False  # axis of error
    last: bool = False  # only the last setting of each curve is judged: the others are other tasks
    without: tuple[str, ...] = ()  # settings that nobody can choose
    labels: bool = True  # settings stand beside their points
    why: str = ""  # the default may be another than the answer


CPU = "CPU seconds"
QUESTIONS = (
    Question(
        "encode", "What does time buy in an encode?", encode.measure, encode.UNIT, CPU, 0.3,
        default=(encode.CALIBRATED, "veryslow"),
    ),
    Question(
        "claims", "How many pictures does a claim need?", survey.measure, survey.OFF, CPU, 0.1,
        default=(survey.OWN, "5"), log=True, labels=False,
        why="it looks again until it is sure, since no number of pictures is enough for every scene",
    ),
    Question(
        "decode", "What does a cheaper rung save in decoding?", decode.measure, decode.UNIT, f"{CPU} a frame", 0.5,
        default=(decode.RUNGS, "L0"), more=True,
    ),
    Question(
        "renderer", "Is a picture in float32 good enough?", renderer.measure, renderer.UNIT, f"{CPU} a picture", 1e-3,
        default=(renderer.SHIPPED, "320 x 320"), log=True, last=True, labels=False,
    ),
    Question(
        "trainer", "How many iterations does a frame need?", trainer.measure, trainer.UNIT, CPU, 0.1,
        default=("direct", "300"), more=True,
    ),
    Question(
        "horizon", "How many segments ahead should a plan look?", selector.horizons, selector.UNIT, f"{CPU} a choice",
        0.1, default=("horizon", str(HORIZON_SEGMENTS)), more=True,
        why="it waits least, which QoE counts for little",
    ),
    Question(
        "policies", "Which policy should choose?", selector.policies, selector.UNIT, f"{CPU} a choice", 0.1,
        default=("policies", DEFAULT_POLICY), more=True, without=tuple(ORACLES),
    ),
)  # fmt: skip
NAMES = tuple(question.name for question in QUESTIONS)
