"""The three kinds of fits of a run: the first frame, a frame in a group, a keyframe after the first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.train.data.multiview import Points, View
from airgs_codec.train.fit.deltas import Driven, Networks
from airgs_codec.train.fit.densify import Growth
from airgs_codec.train.fit.exposure import Tones
from airgs_codec.train.fit.match import Free, Rates, Tick, match
from airgs_codec.train.fit.parameters import ATTRIBUTES, Parameters, from_gaussians, from_points, to_gaussians
from airgs_codec.train.fit.points import initial_points, scene_extent
from airgs_codec.train.fit.seeds import residual_seeds
from airgs_codec.train.fit.temporal import codec_steps
from airgs_codec.train.settings import TrainSettings

START_OPACITY = 0.1
RANDOM_SHARE = 0.3  # of the budget, points to begin with; random ones fill up
HIDDEN_OPACITY = 0.02  # removed at the end of a first frame or, of what was added, of a keyframe
OPACITY_WEIGHT, SCALE_WEIGHT = 0.003, 0.03  # +0.3 dB in held-out views of a first frame; empty space stays empty
SH_SHARE = 0.25  # of the iterations until each further SH band joins
MOVING_RATES = Rates(factor=3.0, means=5.0 / 3, last=0.1, means_last=0.1)  # of frames that start from the one before
KEY_RATES = Rates(factor=8.0, last=0.05, means_last=0.05)  # what has appeared has far to go
MLP_SHARE = 0.5  # of the iterations of mlp+residual


@dataclass(frozen=True, slots=True)
class Trainer:
    """What all fits of a run share."""

    settings: TrainSettings
    extent: float  # world units
    device: str = "cpu"

    def rng(self, frame: int, stage: int) -> np.random.Generator:
        """Its own random numbers for every stage of every frame, so that a run can go on anywhere."""
        return np.random.default_rng([self.settings.seed, frame, stage])

    def first(
        self,
        frame: int,
        given: Points | None,
        views: Sequence[View],
        tones: Tones | None = None,
        tick: Tick = lambda done, of: None,
    ) -> Gaussians:
        """3DGS from a cloud of points, within the budget (AirGS, "Training" 1). `tones` of the views are found too."""
        s = self.settings
        rng = self.rng(frame, 0)
        points = initial_points(given, views, round(RANDOM_SHARE * s.budget), rng)
        assert points.colours is not None
        chosen = np.sort(rng.permutation(len(points.positions))[: s.budget])
        cloud = (points.positions[chosen], points.colours[chosen])
        start = from_points(*cloud, s.sh_degree, START_OPACITY, 0.1 * self.extent)
        free = Free(
            from_gaussians(start, self.device),
            self.extent,
            opacity_weight=OPACITY_WEIGHT,
            scale_weight=SCALE_WEIGHT,
        )
        match(free, views, s.first_iterations, rng, self._ramp, growth=Growth(s.budget), tones=tones, tick=tick)
        free.drop(HIDDEN_OPACITY)
        return to_gaussians(free.detached())

    def frame(
        self,
        frame: int,
        before: Gaussians,
        velocity: np.ndarray | None,
        steps: Parameters,
        views: Sequence[View],
        networks: Networks | None,
        tick: Tick = lambda done, of: None,
    ) -> Gaussians:
        """The Gaussians of the frame before, moved (AirGS, "Training" 2).

        `velocity` (N, 3): what their means moved by at the frame before that. `networks` learn on.
        """
        s = self.settings
        base = from_gaussians(before, self.device)
        weights = self._weights(steps)
        start, iterations, past = self._start(base, velocity), s.frame_iterations, 0
        if networks is not None:
            past = iterations if s.deltas == "mlp" else round(MLP_SHARE * iterations)
            driven = Driven(base, networks, weights)
            match(driven, views, past, self.rng(frame, 1), self._all_bands, tick=lambda i, _: tick(i, iterations))
            moved = driven.detached()
            if s.deltas == "mlp":
                return to_gaussians(moved)
            start = {name: moved[name] - base[name] for name in ATTRIBUTES}
        free = Free(base, self.extent, MOVING_RATES, shrink=weights, start=start)
        match(
            free,
            views,
            iterations - past,
            self.rng(frame, 2),
            self._all_bands,
            tick=lambda i, _: tick(past + i, iterations),
        )
        return to_gaussians(free.detached())

    def keyframe(
        self,
        frame: int,
        before: Gaussians,
        velocity: np.ndarray | None,
        steps: Parameters,
        views: Sequence[View],
        tick: Tick = lambda done, of: None,
    ) -> Gaussians:
        """The Gaussians of the frame before, moved, and new ones (AirGS, "Training" 3). The first U rows stay."""
        s = self.settings
        u = len(before)
        most = min(round((1 + s.added) * u), s.capacity)
        rng = self.rng(frame, 3)
        seeds = residual_seeds(before, views, most - u, 0.1 * self.extent, rng)
        base, weights = from_gaussians(before, self.device), self._weights(steps)
        start = self._start(base, velocity)
        if seeds is not None:
            new = from_gaussians(seeds, self.device)
            zeros = {name: torch.zeros_like(p) for name, p in new.items()}
            base = _joined(base, new)
            start = None if start is None else _joined(start, zeros)
            weights = None if weights is None else _joined(weights, zeros)
        free = Free(
            base,
            self.extent,
            KEY_RATES,
            shrink=weights,
            kept=u,
            inflation=s.inflation,
            start=start,
        )
        match(free, views, s.key_iterations, rng, self._all_bands, growth=Growth(most), tick=tick)
        free.drop(HIDDEN_OPACITY)
        return to_gaussians(free.detached())

    def steps(self, g: Gaussians, views: Sequence[View]) -> Parameters:
        """Codec steps at `g`, on the device."""
        return {name: s.to(self.device) for name, s in codec_steps(g, [v.camera for v in views]).items()}

    def networks(self, g: Gaussians) -> Networks | None:
        """Networks for a group that starts at `g`, if the frames are fitted with them."""
        if self.settings.deltas == "direct":
            return None
        return Networks(from_gaussians(g, self.device), self.extent, self.settings.seed).to(self.device)

    def _weights(self, steps: Parameters) -> Parameters | None:
        temporal = self.settings.temporal
        return temporal.weights(steps) if temporal.weight else None

    def _start(self, base: Parameters, velocity: np.ndarray | None) -> Parameters | None:
        if velocity is None:
            return None
        start = {name: torch.zeros_like(p) for name, p in base.items()}
        start["means"] = torch.from_numpy(velocity.astype(np.float32)).to(self.device)
        return start

    def _ramp(self, done: float) -> int:
        return min(self.settings.sh_degree, int(done / SH_SHARE))

    def _all_bands(self, done: float) -> int:
        return self.settings.sh_degree


def make_trainer(settings: TrainSettings, views: Sequence[View], points: Points | None, device: str) -> Trainer:
    """For a scene seen by `views`."""
    return Trainer(settings, scene_extent([view.camera for view in views], points), device)


def _joined(a: Parameters, b: Parameters) -> Parameters:
    return {name: torch.cat([a[name], b[name]]) for name in ATTRIBUTES}
