"""The first baseline: 3D Gaussian Splatting (Kerbl et al. 2023) of every frame on its own, fetched as .ply files."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass

import numpy as np
import torch

from airgs_codec.errors import SceneError
from airgs_codec.progress import Progress
from airgs_codec.scene.formats.ply import write_ply
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.trainer.fit.optimise import Schedule, optimise
from airgs_codec.trainer.fit.points import from_points, initial_points, scene_extent
from tools.lab.baselines.method import Footage, Shown, frame_path
from tools.lab.baselines.threedgs import GRADIENT, ITERATIONS, SH_EVERY, START_OPACITY, Splats, Timetable


@dataclass(frozen=True, slots=True)
class Naive3dgs:
    """3DGS of every frame; the paper's schedule is shrunk to so many iterations."""

    iterations: int = 1_500
    sh_degree: int = 1
    gradient: float = 2 * GRADIENT  # from which rows are added
    rate: float = 3.0  # factor on the learning rates of the paper, which are made for 30,000 iterations
    points: int = 2_400  # fewest to start from; random ones fill up
    seed: int = 0

    @property
    def name(self) -> str:
        return "naive3dgs"

    @property
    def settings(self) -> dict[str, object]:
        return asdict(self)

    def frames(self, footage: Footage, done: int, progress: Progress) -> Iterator[Shown]:
        """The frames from number `done` on. Raises SceneError where there is nothing to train on or to start from."""
        torch.set_num_threads(1)  # the renderer has threads of its own
        footage.folder.mkdir(parents=True, exist_ok=True)
        for t in range(done, footage.frames):
            begun = time.perf_counter()
            g = self.fit(footage, t, progress)
            path = frame_path(footage.folder, t)
            write_ply(path, g)
            yield Shown("key", g, path.stat().st_size, time.perf_counter() - begun)

    def fit(self, footage: Footage, frame: int, progress: Progress) -> Gaussians:
        """One frame, from the scene's points if it is the first, and from triangulated ones if not."""
        views = footage.pictures.train(frame)
        if not views:
            raise SceneError(f"expected training views of frame {frame}, got none")
        rng = np.random.default_rng([self.seed, frame])
        cloud = initial_points(None if frame else footage.points, views, self.points, rng)
        assert cloud.colours is not None  # `initial_points` gives every point one
        extent = scene_extent([view.camera for view in views], cloud)
        start = from_points(cloud.positions, cloud.colours, self.sh_degree, START_OPACITY, extent)
        timetable = Timetable(gradient=self.gradient).scaled(self.iterations / ITERATIONS)
        splats = Splats(start, extent, timetable, self.seed, self.rate)
        schedule = Schedule(f"frame {frame} of {footage.frames}", self.iterations, self._sh_degree)
        optimise(splats, views, schedule, rng, progress=progress)
        return splats.gaussians()

    def _sh_degree(self, done: float) -> int:
        return min(self.sh_degree, int(done * ITERATIONS / SH_EVERY))
