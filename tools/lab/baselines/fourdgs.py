"""4D Gaussian Splatting (Wu et al., CVPR 2024): one set of Gaussians, and a field that deforms it at every time.

All frames are trained together: first static Gaussians that suit all of them, then Gaussians and field.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch

from airgs_codec.errors import SceneError
from airgs_codec.progress import Progress
from airgs_codec.scene.formats.ply import read_ply, write_ply
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.trainer.data.pictures import View
from airgs_codec.trainer.fit.optimise import Losses
from airgs_codec.trainer.fit.parameters import from_gaussians, render, to_gaussians
from airgs_codec.trainer.fit.points import from_points, initial_points, scene_extent
from tools.lab.baselines.hexplane import Field, FieldSize, PlaneWeights, plane_loss
from tools.lab.baselines.method import Footage, Shown
from tools.lab.baselines.threedgs import SH_EVERY, START_OPACITY, Splats, Timetable

COARSE, FINE = 3_000, 14_000  # iterations of the two stages in the paper, for videos of several cameras
TIMETABLES = (Timetable(reset=None), Timetable(stop=10_000, reset=None))  # of the two stages
MLP_RATE, PLANE_RATE, RATE_LAST = 1.6e-4, 1.6e-3, 0.1  # times the scene's extent; the share that is left at the end
MODEL = "model"  # its folder


@dataclass(frozen=True, slots=True)
class Fourdgs:
    """4DGS of all frames together; the paper's schedule is shrunk to so many iterations, of both stages."""

    iterations: int = 6_000
    sh_degree: int = 3
    gradient: float = 8e-4  # from which rows are added; four times the paper's, for pictures of a CPU's size
    points: int = 2_400  # fewest to start from; random ones fill up
    cells: int = 64  # of a plane along an axis of space, at the coarser resolution
    rate: float = 1.0  # factor on the learning rates of the field
    seed: int = 0

    @property
    def name(self) -> str:
        return "4dgs"

    @property
    def settings(self) -> dict[str, object]:
        return asdict(self)

    def frames(self, footage: Footage, done: int, progress: Progress) -> Iterator[Shown]:
        """The frames from number `done` on, after the training of all of them.

        Raises SceneError where there is nothing to train on or to start from.
        """
        torch.set_num_threads(1)  # the renderer has threads of its own
        footage.folder.mkdir(parents=True, exist_ok=True)
        fit = Fit(self, footage)
        while fit.iteration < fit.total:
            fit.step()
            progress("all frames", fit.iteration, fit.total)
        sizes = spread(write_model(footage.folder / MODEL, fit.splats.gaussians(), fit.field), footage.frames)
        g = read_model(footage.folder / MODEL, fit.field)
        for t in range(done, footage.frames):
            shown = deformed(g, fit.field, t / max(1, footage.frames - 1))
            yield Shown("frame" if t else "key", shown, sizes[t], fit.seconds / footage.frames)


class Fit:
    splats: Splats
    field: Field

    def __init__(self, method: Fourdgs, footage: Footage) -> None:
        self._method, self._footage = method, footage
        self._factor = method.iterations / (COARSE + FINE)
        self._coarse = round(COARSE * self._factor)
        self._seen = _all_views(footage)
        self._order = _order(len(self._seen), method.iterations, method.seed)
        self._losses = Losses(1)
        self.total = method.iterations
        self.iteration = 0
        self.seconds = 0.0
        self._begin()

    def step(self) -> None:
        """One iteration. Raises TrainingError where the loss is not finite or no Gaussian is left."""
        begun = time.perf_counter()
        if self.iteration == self._coarse:
            self.splats = self._make_splats(self.splats.gaussians(), 1)
        self.iteration += 1
        fine = self.iteration > self._coarse
        frame, view = self._seen[self._order[self.iteration - 1]]
        p = self.splats.current()
        if fine:
            p = self.field(p, frame / max(1, self._footage.frames - 1))
        degree = min(self._method.sh_degree, int(self.iteration / self._factor / SH_EVERY))
        rgb, _ = render(p, view.camera, degree, self.splats.watch())
        loss = (rgb - torch.from_numpy(view.target.rgb)).abs().mean()
        if fine:
            loss = loss + plane_loss(self.field, PlaneWeights())
        self._losses.add(self.iteration, [view], loss, last=True)
        loss.backward()
        if fine:
            done, iterations = self.iteration - self._coarse, self.total - self._coarse
            self._move_field(done / iterations)
        else:
            done, iterations = self.iteration, self._coarse
        self.splats.step(done, iterations)
        self.seconds += time.perf_counter() - begun

    def _begin(self) -> None:
        m, footage = self._method, self._footage
        views = footage.pictures.train(0)
        cloud = initial_points(footage.points, views, m.points, np.random.default_rng(m.seed))
        assert cloud.colours is not None  # `initial_points` gives every point one
        self._extent = scene_extent([view.camera for view in views], cloud)
        start = from_points(cloud.positions, cloud.colours, m.sh_degree, START_OPACITY, self._extent)
        self.splats = self._make_splats(start, 0)
        low, high = (torch.from_numpy(bound(cloud.positions, axis=0)) for bound in (np.min, np.max))
        size = FieldSize(cells=m.cells, moments=max(2, footage.frames // 2))
        self.field = Field(size, low, high, m.seed)
        groups = [[p for n, p in self.field.named_parameters() if n.startswith("planes.") == yes] for yes in (0, 1)]
        self._adam = torch.optim.Adam([{"params": group} for group in groups], eps=1e-15)

    def _make_splats(self, start: Gaussians, stage: int) -> Splats:
        timetable = replace(TIMETABLES[stage], gradient=self._method.gradient).scaled(self._factor)
        return Splats(start, self._extent, timetable, self._method.seed)

    def _move_field(self, done: float) -> None:
        for group, rate in zip(self._adam.param_groups, (MLP_RATE, PLANE_RATE), strict=True):
            group["lr"] = rate * self._method.rate * self._extent * RATE_LAST**done
        self._adam.step()
        self._adam.zero_grad(set_to_none=True)


@torch.no_grad()
def deformed(g: Gaussians, field: Field, at: float) -> Gaussians:
    """The Gaussians as the field has them at a time of 0..1."""
    return to_gaussians(field(from_gaussians(g), at))


def write_model(folder: Path, g: Gaussians, field: Field) -> int:
    """Write what a viewer fetches, all in float32: the Gaussians as .ply and the field. Gives its bytes."""
    folder.mkdir(exist_ok=True)
    splats, numbers = folder / "canonical.ply", folder / "field.npz"
    write_ply(splats, g)
    np.savez(numbers, **{name: value.numpy() for name, value in field.state_dict().items()})  # type: ignore[arg-type]
    return splats.stat().st_size + numbers.stat().st_size


def read_model(folder: Path, field: Field) -> Gaussians:
    """Return the Gaussians that `write_model` wrote; the field, of the same size, takes the numbers of that one."""
    with np.load(folder / "field.npz", allow_pickle=False) as arrays:
        field.load_state_dict({name: torch.from_numpy(np.array(value)) for name, value in arrays.items()})
    return read_ply(folder / "canonical.ply")


def spread(total: int, frames: int) -> list[int]:
    """Bytes of each frame, as even as can be, that sum to `total`."""
    return [total * (t + 1) // frames - total * t // frames for t in range(frames)]


def _all_views(footage: Footage) -> list[tuple[int, View]]:
    """Every training picture with its frame. Raises SceneError for a frame without any."""
    seen = []
    for t in range(footage.frames):
        views = footage.pictures.train(t)
        if not views:
            raise SceneError(f"expected training views of frame {t}, got none")
        seen += [(t, view) for view in views]
    return seen


def _order(pictures: int, iterations: int, seed: int) -> list[int]:
    """The picture of each iteration: all of them in random order, then all again."""
    rng = np.random.default_rng([seed, pictures])
    rounds = [rng.permutation(pictures) for _ in range(-(-iterations // pictures))]
    return np.concatenate(rounds)[:iterations].tolist()
