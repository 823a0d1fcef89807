"""The methods that are compared, by name, and what a quick run of each is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from airgs_codec.encoder.settings import EncodeSettings, as_in_paper
from airgs_codec.trainer.settings import TrainSettings, preset
from tools.lab.baselines.airgs import AirGS
from tools.lab.baselines.fourdgs import Fourdgs
from tools.lab.baselines.method import Method
from tools.lab.baselines.naive3dgs import Naive3dgs
from tools.lab.baselines.stream3dgs import Stream3dgs, StreamSettings
from tools.lab.baselines.v3 import V3, V3Settings
from tools.lab.paper.scenes import Subject

QUICK_FIRST = 300  # iterations of a fit from scratch in a quick run


def make_method(name: str, subject: Subject, quick: bool) -> Method:
    return METHODS[name](subject, quick)


def trainer_settings(subject: Subject, quick: bool) -> TrainSettings:
    """The default settings of the trainer, at the size of the pictures of a scene."""
    settings = TrainSettings(max_size=subject.size)
    if not quick:
        return settings
    return replace(settings, first_iterations=QUICK_FIRST, key_iterations=150, frame_iterations=60, budget=2_000)


def _airgs(subject: Subject, quick: bool) -> Method:
    return AirGS(subject.open(), trainer_settings(subject, quick))


def _paper(subject: Subject, quick: bool) -> Method:
    """The whole system of the paper: its trainer, its levels."""
    training = preset("paper", trainer_settings(subject, quick))
    return AirGS(subject.open(), training, as_in_paper(EncodeSettings()), name="airgs-paper")


def _v3(_: Subject, quick: bool) -> Method:
    short = V3Settings(rows=2_000, key_iterations=QUICK_FIRST, finetune_iterations=60, frame_iterations=40)
    return V3(short if quick else V3Settings())


def _stream(subject: Subject, quick: bool) -> Method:
    first = trainer_settings(subject, quick)
    return Stream3dgs(StreamSettings(first, iterations=40, added_iterations=20) if quick else StreamSettings(first))


def _fourdgs(_: Subject, quick: bool) -> Method:
    return Fourdgs(iterations=2 * QUICK_FIRST) if quick else Fourdgs()


def _naive(_: Subject, quick: bool) -> Method:
    return Naive3dgs(iterations=QUICK_FIRST) if quick else Naive3dgs()


METHODS: dict[str, Callable[[Subject, bool], Method]] = {
    "airgs": _airgs, "airgs-paper": _paper, "v3": _v3, "3dgstream": _stream, "4dgs": _fourdgs, "naive3dgs": _naive,
}  # fmt: skip
