"""What pictures of a scene say about its Gaussians: how much each is seen, what errors it can bear, which are needed.

N Gaussians of a group after repairs.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from airgs_codec.analysis.importance import RowPruning, WrittenRows, importance, removal_errors
from airgs_codec.analysis.sensitivity import Sensitivity, measure_views
from airgs_codec.encoder.views import SceneViews
from airgs_codec.render import Camera
from airgs_codec.render.backend import Renderer
from airgs_codec.scene.beside import Usage
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.sequence import GaussianSequence

Span = tuple[int, int]  # frames [start, stop)
MAXIMUM = partial(np.max, axis=0)  # of each number in several columns


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """The frames of a group, and of the groups after it that its keyframe is chosen for, in their sequence."""

    sequence: GaussianSequence
    number: int  # of the group, from 0
    spans: tuple[Span, ...]  # of the group itself, then of those whose keyframes may be coded against its own
    first_segment: int = 0  # how many segments the groups before it have
    begins: bool = True  # its keyframe is coded by itself

    @property
    def start(self) -> int:
        return self.spans[0][0]

    @property
    def stop(self) -> int:
        return self.spans[0][1]

    @property
    def words(self) -> str:
        return f"frames {self.start}-{self.stop - 1}"


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """What pictures of the frames of some groups say about each Gaussian."""

    until: int  # the frames that were looked at end here
    usage: Usage
    sensitivity: Sensitivity
    importance: NDArray[np.float64]  # (N,) as `analysis.importance` has it
    expected: NDArray[np.float64]  # (N,) `removal_errors`
    checks: list[tuple[Gaussians, Camera]]  # other pictures, which show what leaving Gaussians out would do
    renderer: Renderer
    errors: dict[int, float] = field(default_factory=dict)  # Gaussians left out -> error that `checks` have shown

    @staticmethod
    def of(frames: Frames, views: SceneViews, renderer: Renderer) -> Survey:
        """Look at a group and those that its keyframe is chosen for; usage is the trainer's where that is known."""
        sequence, seen = frames.sequence, range(frames.start, frames.spans[-1][1])
        decide, check = views.decide(seen, len(frames.spans)), views.check(seen)
        numbers = sorted({number for number, _ in (*decide, *check)})
        loaded = dict(zip(numbers, sequence.load(numbers).frames, strict=True))
        decided, checked = ([(loaded[number], camera) for number, camera in some] for some in (decide, check))
        usage, sensitivity = measure_views(decided, renderer)
        known = [sequence.usage(*span) for span in frames.spans]
        measured = [one for one in known if one is not None and len(one.peak) == len(usage.peak)]
        usage = Usage.combined(measured, MAXIMUM) if len(measured) == len(known) else usage
        expected = removal_errors(list(loaded.values()), sensitivity)
        return Survey(seen.stop, usage, sensitivity, importance(expected, usage), expected, checked, renderer)

    @property
    def pruning(self) -> RowPruning:
        return RowPruning(self.checks, self.importance, self.expected, self.errors, self.renderer)

    def score(self, name: str) -> NDArray[np.float64]:
        """Return (N,) one of `beside.MEASURES`: what ranks Gaussians for keyframe tiers."""
        return self.importance if name == "importance" else self.usage.measure(name)

    def needed(self, allowed: float | None) -> WrittenRows:
        """Choose the Gaussians that pictures cannot do without, see `EncodeSettings.row_error`, or all."""
        if allowed is None:
            return WrittenRows.all(len(self.importance))
        pruning = self.pruning
        return pruning.with_details(pruning.within(allowed), allowed)

    def joined(self, other: Survey) -> Survey:
        """Give each Gaussian the most that either survey says of it."""
        ranked, expected = (np.maximum(getattr(self, of), getattr(other, of)) for of in ("importance", "expected"))
        usage = Usage.combined([self.usage, other.usage], MAXIMUM)
        sensitivity = Sensitivity.combined([self.sensitivity, other.sensitivity], MAXIMUM)
        return replace(self, usage=usage, sensitivity=sensitivity, importance=ranked, expected=expected, errors={})
