"""What the views of a scene say about its groups, before any setting matters. N rows of a group after repairs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airgs_codec.analysis.grouping import middle_frame
from airgs_codec.analysis.importance import importance
from airgs_codec.analysis.sensitivity import Sensitivity, measure_sensitivity
from airgs_codec.analysis.usage import measure_usage
from airgs_codec.package.tables import Views
from airgs_codec.progress import Progress
from airgs_codec.render import Camera
from airgs_codec.scene.camera import measured_views, training_views
from airgs_codec.scene.orbits import orbit_views
from airgs_codec.scene.sequence import GaussianSequence
from airgs_codec.scene.usage import Usage


@dataclass(frozen=True, slots=True, eq=False)
class ViewSplit:
    """The cameras that decide what matters, and those that quality is measured with."""

    training: Sequence[Camera]
    measured: Sequence[Camera]
    given: bool  # the scene came with cameras; else they are on an orbit around it

    @staticmethod
    def of(sequence: GaussianSequence) -> ViewSplit:
        """The scene's cameras, held-out ones apart; cameras on an orbit where it has none."""
        given = list(sequence.cameras)
        cameras = given or orbit_views(sequence.read(len(sequence) // 2))
        return ViewSplit(training_views(cameras), measured_views(cameras), bool(given))

    def table(self, reference: str) -> Views:
        """The record of these views in airgs.json; `reference` is what quality is measured against, or "none"."""
        source, first = "given" if self.given else "generated", self.measured[0]
        return Views(source, len(self.training), len(self.measured), first.width, first.height, reference)


@dataclass(frozen=True, slots=True)
class GroupSpan:
    """Frames [start, stop) that share a canonical space."""

    index: int  # of the group
    start: int
    stop: int

    @property
    def frames(self) -> int:
        """Number of frames."""
        return self.stop - self.start

    @property
    def canonical(self) -> int:
        """Number of the canonical frame in the sequence."""
        return middle_frame(self.start, self.stop)

    @property
    def middle(self) -> int:
        """Place of the canonical frame among the frames of the group."""
        return self.canonical - self.start

    @property
    def surveyed(self) -> list[int]:
        """Places in the group of the frames that are rendered for a survey: first, canonical and last."""
        return sorted({0, self.middle, self.frames - 1})


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """What the training views say about the rows of a group."""

    span: GroupSpan
    usage: Usage
    sensitivity: Sensitivity
    importance: NDArray[np.float64]  # (N,) of `analysis.importance`

    def score(self, name: str) -> NDArray[np.float64]:
        """(N,) one of `usage.MEASURES`: what ranks rows for key tiers."""
        return self.importance if name == "importance" else self.usage.measure(name)


def survey_group(sequence: GaussianSequence, span: GroupSpan, cameras: Sequence[Camera]) -> Survey:
    """Survey one group over its first, canonical and last frame; with the trainer's usage, over all, where it fits."""
    loaded = sequence.load(range(span.start, span.stop)).frames
    frames = [loaded[i] for i in span.surveyed]
    known = sequence.usage(span.start, span.stop)
    usage = known if known is not None and len(known.peak) == len(loaded[0]) else measure_usage(frames, cameras)
    sensitivity = measure_sensitivity(frames, cameras)
    return Survey(span, usage, sensitivity, importance(frames, usage, sensitivity))


def survey_groups(
    sequence: GaussianSequence, spans: Sequence[tuple[int, int]], cameras: Sequence[Camera], progress: Progress
) -> list[Survey]:
    """Survey the groups whose frames are [start, stop), one after the other."""
    surveys = []
    for index, (start, stop) in enumerate(spans):
        progress("training views", index, len(spans))
        surveys.append(survey_group(sequence, GroupSpan(index, start, stop), cameras))
    return surveys
