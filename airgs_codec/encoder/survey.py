"""What the views of a scene say about its groups, before any setting matters. N rows of a group after repairs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from airgs_codec.analysis.importance import importance
from airgs_codec.analysis.sensitivity import Sensitivity, measure_views
from airgs_codec.encoder.views import Pictures, ViewPlan
from airgs_codec.render import Camera
from airgs_codec.render.backend import CPU, Renderer
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.sequence import GaussianSequence
from airgs_codec.scene.usage import Usage


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
    def middle(self) -> int:
        """Number of the frame in its middle."""
        return self.start + (self.stop - self.start) // 2


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """What views of all frames say about the rows of a group."""

    span: GroupSpan
    checks: Pictures  # other ones, which show what leaving out would do
    usage: Usage
    sensitivity: Sensitivity
    importance: NDArray[np.float64]  # (N,) of `analysis.importance`
    trusted: bool  # rows that no picture shows may be left out
    renderer: Renderer = CPU
    removals: dict[int, float] = field(default_factory=dict)  # errors in `checks` known so far, see `RowPruning`

    def score(self, name: str) -> NDArray[np.float64]:
        """(N,) one of `usage.MEASURES`: what ranks rows for key tiers."""
        return self.importance if name == "importance" else self.usage.measure(name)


@dataclass(frozen=True, slots=True, eq=False)
class ShownPictures:
    """Pictures of a group with the Gaussians that they show, one at a time."""

    frames: Sequence[Gaussians]  # all of the group
    pictures: Pictures

    def __iter__(self) -> Iterator[tuple[Gaussians, Camera]]:
        return ((self.frames[place], camera) for place, camera in self.pictures)


def survey_group(sequence: GaussianSequence, span: GroupSpan, views: ViewPlan) -> Survey:
    """Survey one group over all of its frames; where the trainer's usage fits its rows, it takes precedence."""
    frames = sequence.load(range(span.start, span.stop)).frames
    pictures = sorted(views.decide(span.frames), key=lambda picture: picture[0])  # those of one frame share work
    usage, sensitivity = measure_views(ShownPictures(frames, pictures), views.renderer)
    known = sequence.usage(span.start, span.stop)
    if known is not None and len(known.peak) == len(frames[0]):
        usage = known
    ranked = importance(frames, usage, sensitivity)
    return Survey(span, views.check(span.frames), usage, sensitivity, ranked, views.trusted, views.renderer)
