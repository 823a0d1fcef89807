"""4D Gaussian Splatting (Wu et al., CVPR 2024): one set of Gaussians, and a field that deforms it at every time.

The field (section 4.2) is a HexPlane and heads of a small MLP. All frames are trained together: first static Gaussians
that suit all of them, then Gaussians and field. N Gaussians, T moments, R cells along an axis of space, F features, L
resolutions.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from functools import reduce
from itertools import combinations
from pathlib import Path

import numpy as np
import torch

from airgs_codec.errors import SceneError
from airgs_codec.progress import Progress
from airgs_codec.scene.formats.ply import read_ply, write_ply
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.trainer.data.pictures import View
from airgs_codec.trainer.fit.losses import Parameters, from_gaussians, render, to_gaussians
from airgs_codec.trainer.fit.optimise import LossCheck
from airgs_codec.trainer.fit.points import from_points, initial_points, scene_extent
from tools.lab.baselines.method import Footage, Shown
from tools.lab.baselines.threedgs import SH_EVERY, START_OPACITY, Splats, Timetable

AXES = 4  # x, y, z, t
PAIRS = tuple(combinations(range(AXES), 2))  # xy, xz, xt, yz, yt, zt
TIME = AXES - 1
HEADS = {"means": 3, "log_scales": 3, "quaternions": 4}  # what deforms; opacity and colour do not, as in the paper


@dataclass(frozen=True, slots=True)
class FieldSize:
    cells: int = 64  # R of the coarsest resolution
    moments: int = 12  # T, of all resolutions
    features: int = 16  # F of a plane
    resolutions: tuple[int, ...] = (1, 2)  # times R
    width: int = 64  # of a hidden layer


class Field(torch.nn.Module):
    """How Gaussians deform at a time: six planes at each resolution, a linear layer, a head for each attribute."""

    low: torch.Tensor
    high: torch.Tensor

    def __init__(self, size: FieldSize, low: torch.Tensor, high: torch.Tensor, seed: int) -> None:
        """`low`, `high`: (3,) corners of the box that the planes span, world units. `seed`: of the first numbers."""
        super().__init__()
        draw = torch.Generator().manual_seed(seed)
        self.register_buffer("low", low)
        self.register_buffer("high", high)
        self.planes = torch.nn.ParameterList(
            [_plane(pair, size, r, draw) for r in size.resolutions for pair in PAIRS]  # (1, F, rows, columns)
        )
        self.first = _linear(size.features * len(size.resolutions), size.width, draw)
        self.heads = torch.nn.ModuleDict({name: _head(size.width, out, draw) for name, out in HEADS.items()})

    def forward(self, p: Mapping[str, torch.Tensor], time: float) -> Parameters:
        """The Gaussians as they are at `time`, which is 0 at the first frame and 1 at the last."""
        hidden = self.first(self.encode(p["means"], time))
        return {name: value + self.heads[name](hidden) if name in HEADS else value for name, value in p.items()}

    def encode(self, means: torch.Tensor, time: float) -> torch.Tensor:
        """(N, F L) features: the product of the six planes at the means (N, 3) and the time, for each resolution.

        Beyond the box a plane has the values of its border.
        """
        place = 2 * (means - self.low) / (self.high - self.low) - 1
        axes = [*place.unbind(1), torch.full_like(place[:, 0], 2 * time - 1)]
        found = []
        for k in range(0, len(self.planes), len(PAIRS)):
            planes = zip(PAIRS, self.planes[k : k + len(PAIRS)], strict=True)
            found.append(reduce(torch.mul, [_sample(plane, axes[a], axes[b]) for (a, b), plane in planes]))
        return torch.cat(found, dim=0).t()


@dataclass(frozen=True, slots=True)
class PlaneWeights:
    """Weights of what planes add to the loss: the defaults of the authors' program."""

    space: float = 1e-4  # of the smoothness of planes of space
    time: float = 0.01  # of the smoothness of planes of time, along time
    still: float = 1e-4  # of the mean distance of planes of time from 1, at which nothing moves


def plane_loss(field: Field, weights: PlaneWeights) -> torch.Tensor:
    """Total variation of the planes (Wu et al. 2024, equation 7), of second differences, and what holds time at 1."""
    total = torch.zeros(())
    for k, plane in enumerate(field.planes):
        if TIME in PAIRS[k % len(PAIRS)]:
            total = total + weights.time * _roughness(plane) + weights.still * (1 - plane).abs().mean()
        else:
            total = total + weights.space * _roughness(plane)
    return total


def _roughness(plane: torch.Tensor) -> torch.Tensor:
    """Mean square of the second difference between rows, which of planes of time are moments."""
    if plane.shape[2] < 3:
        return torch.zeros(())  # the mean of no differences would be 0 / 0
    step = plane[..., 1:, :] - plane[..., :-1, :]
    return (step[..., 1:, :] - step[..., :-1, :]).square().mean()


def _plane(pair: tuple[int, int], size: FieldSize, times: int, draw: torch.Generator) -> torch.nn.Parameter:
    """Columns are the first axis of the pair and rows the second; planes of time start at 1."""
    rows = size.moments if TIME in pair else size.cells * times
    shape = (1, size.features, rows, size.cells * times)
    return torch.nn.Parameter(torch.ones(shape) if TIME in pair else 0.1 + 0.4 * torch.rand(shape, generator=draw))


def _sample(plane: torch.Tensor, column: torch.Tensor, row: torch.Tensor) -> torch.Tensor:
    grid = torch.stack([column, row], dim=1)[None, None]
    return torch.nn.functional.grid_sample(plane, grid, padding_mode="border", align_corners=True)[0, :, 0]


def _linear(inputs: int, outputs: int, draw: torch.Generator) -> torch.nn.Linear:
    layer = torch.nn.Linear(inputs, outputs)
    torch.nn.init.xavier_uniform_(layer.weight, generator=draw)
    torch.nn.init.zeros_(layer.bias)
    return layer


def _head(width: int, outputs: int, draw: torch.Generator) -> torch.nn.Sequential:
    hidden, last = _linear(width, width, draw), _linear(width, outputs, draw)
    torch.nn.init.zeros_(last.weight)
    return torch.nn.Sequential(torch.nn.ReLU(), hidden, torch.nn.ReLU(), last)


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
    rows: int | None = None  # most Gaussians; None: as many as the gradient asks for
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
            yield Shown("frame" if t else "keyframe", shown, sizes[t])


class Fit:
    splats: Splats
    field: Field

    def __init__(self, method: Fourdgs, footage: Footage) -> None:
        self._method, self._footage = method, footage
        self._factor = method.iterations / (COARSE + FINE)
        self._coarse = round(COARSE * self._factor)
        self._seen = _all_views(footage)
        self._order = _order(len(self._seen), method.iterations, method.seed)
        self._losses = LossCheck(1)
        self.total = method.iterations
        self.iteration = 0
        self._begin()

    def step(self) -> None:
        """One iteration. Raises TrainingError where the loss is not finite or no Gaussian is left."""
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
        return Splats(start, self._extent, timetable, self._method.seed, self._method.rows)

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
    np.savez(numbers, **{name: value.numpy() for name, value in field.state_dict().items()})
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
