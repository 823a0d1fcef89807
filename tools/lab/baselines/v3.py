"""V^3 (Wang et al., SIGGRAPH Asia 2024): groups of one length, moved in two stages, sent as one video an attribute.

A keyframe is trained from scratch and pruned. Every later frame of its group is the one before, first moved by a hash
grid that gives a displacement at every place, then fine-tuned with losses that hold the residual to the frame before.
Written from the paper; docs/results/size.md says what is simplified. N Gaussians, C channels, T frames of a group.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field

import numpy as np
import torch

from airgs_codec.places.whole import write_json
from airgs_codec.progress import Progress
from airgs_codec.scene.formats.ply import write_ply
from airgs_codec.scene.gaussians import Gaussians, morton_order
from airgs_codec.trainer.fit.losses import Parameters, from_gaussians, to_gaussians
from airgs_codec.trainer.fit.optimise import BETAS, PerGaussian, Rates, Schedule, optimise
from airgs_codec.trainer.fit.trainer import (
    FIRST_REGULARISERS,
    MOVING_RATES,
    FrameViews,
    Trainer,
    fit_first,
    make_trainer,
)
from airgs_codec.trainer.settings import TrainSettings
from tools.lab.baselines.hashgrid import FieldSettings, HashField, Places
from tools.lab.baselines.method import Footage, Shown, frame_path
from tools.lab.rd.layouts import V3_FORMS, v3_layout

HELD = ("log_scales", "quaternions", "opacity_logits")  # what both losses hold
CODES = 255  # steps of an 8-bit picture
FIELD_RATE, FIELD_LAST = 1e-2, 0.1  # learning rate of the hash grid, and the share of it that is left at the end
DISPLACEMENT = 0.01  # of the scene's extent: what an output of 1 of the hash grid means
BOX_SHARE, BOX_MARGIN = 0.01, 0.02  # rows left out at each side of the field's box; its margin, of the scene's extent
PRUNED_RATES = Rates(factor=3.0, means=5.0 / 3, last=0.1, means_last=0.1)  # of a keyframe; MOVING_RATES of frames
GRID_BITS = 10  # of each axis, for the order of rows


@dataclass(slots=True, eq=False)
class ResidualLoss:
    """weight * mean squared residual + weight * estimated bits of a sample of the quantised residual."""

    before: Parameters
    temporal: float
    entropy: float
    seed: int  # of the noise
    form: str = V3_FORMS[0]
    _shown: dict[str, torch.Tensor] = field(init=False)  # (N, C) as the codec codes it
    _steps: dict[str, torch.Tensor] = field(init=False)  # (C,) of the codec
    _noise: torch.Generator = field(init=False)

    def __post_init__(self) -> None:
        self._shown = {name: coded_domain(name, self.before[name], self.form) for name in HELD}
        spans = {name: values.amax(dim=0) - values.amin(dim=0) for name, values in self._shown.items()}
        self._steps = {n: torch.where(span > 0, span, torch.ones_like(span)) / CODES for n, span in spans.items()}
        self._noise = torch.Generator().manual_seed(self.seed)

    def __call__(self, residual: Mapping[str, torch.Tensor]) -> torch.Tensor:
        """The loss of a residual (N, ...) of every attribute, in stored domain."""
        total = self.temporal * torch.stack([residual[name].square().mean() for name in HELD]).sum()
        if not self.entropy:
            return total
        codes = torch.cat([self._codes(name, residual[name]) for name in HELD], dim=1)
        noise = torch.rand(codes.shape, generator=self._noise) - 0.5
        return total + self.entropy * estimated_bits(codes + noise)

    def _codes(self, name: str, residual: torch.Tensor) -> torch.Tensor:
        now = coded_domain(name, self.before[name] + residual, self.form)
        return (now - self._shown[name]) / self._steps[name]


def coded_domain(name: str, values: torch.Tensor, form: str) -> torch.Tensor:
    """(N, C) values of an attribute as this form of V^3 codes them: scales and opacities activated, or as they are."""
    values = values.reshape(len(values), -1)
    if form != V3_FORMS[0]:
        return values
    return values.exp() if name == "log_scales" else values.sigmoid() if name == "opacity_logits" else values


def estimated_bits(samples: torch.Tensor) -> torch.Tensor:
    """Bits of a sample, mean over rows, summed over channels, of samples (N, C) that noise stands for rounding in.

    Each channel has a normal distribution with the mean mu and the deviation sigma of its N samples; a sample x takes
    -log2 (Phi((x + 1/2 - mu) / sigma) - Phi((x - 1/2 - mu) / sigma)). Computed from logarithms of Phi in the lower
    tail, where their difference does not cancel.
    """
    mean = samples.mean(dim=0)
    deviation = (samples.var(dim=0, correction=0) + 1e-6).sqrt()  # of one row it is 0, and 0 / 0 follows
    below = -(samples - mean).abs() / deviation
    half = 0.5 / deviation
    upper, lower = torch.special.log_ndtr(below + half), torch.special.log_ndtr(below - half)
    nats = -(upper + torch.log(-torch.expm1(lower - upper)))
    return nats.mean(dim=0).sum() / math.log(2)


@dataclass(frozen=True, slots=True)
class V3Settings:
    group_frames: int = 20
    rows: int = 8_000  # Gaussians of a keyframe after pruning, at most
    pruned: float = 0.5  # share of a keyframe's Gaussians that is removed, those of lowest opacity
    sh_degree: int = 1
    keyframe_iterations: int = 2_000
    finetune_iterations: int = 700  # of a keyframe, after pruning
    field_iterations: int = 80  # of the hash grid, a frame
    frame_iterations: int = 300  # of all attributes, a frame
    coarse: float = 0.4  # share of a frame's iterations, the first ones, that see pictures of half the size
    temporal: float = 1e-3  # weight of the temporal loss
    entropy: float = 1e-4  # weight of the residual entropy loss
    qps: tuple[int, ...] = (14, 22, 46)  # of the attribute videos: what is shown, and what else viewers may have
    preset: str = "veryslow"  # of x264: as much effort as airgs has
    form: str = V3_FORMS[0]  # in which the videos, and the losses, have scales and opacities
    seed: int = 0

    def training(self) -> TrainSettings:
        budget = round(self.rows / (1 - self.pruned))
        return TrainSettings(
            budget=budget,
            capacity=budget,
            sh_degree=self.sh_degree,
            first_iterations=self.keyframe_iterations,
            coarse=self.coarse,
            seed=self.seed,
        )


@dataclass(frozen=True, slots=True)
class V3:
    chosen: V3Settings = field(default_factory=V3Settings)
    name: str = "v3"

    @property
    def settings(self) -> dict[str, object]:
        return asdict(self.chosen)

    def frames(self, footage: Footage, done: int, progress: Progress) -> Iterator[Shown]:
        """The frames from number `done` on: a group is trained, from its first frame on, then coded, then shown."""
        s = self.chosen
        trainer = make_trainer(s.training(), footage.pictures.train(0), footage.points, "cpu")
        for start in range(done - done % s.group_frames, footage.frames, s.group_frames):
            group: list[Gaussians] = []
            for t in range(start, min(start + s.group_frames, footage.frames)):
                target = FrameViews(t, footage.pictures.train(t))

                def named(stage: str, done: int, total: int, t: int = t) -> None:
                    progress(f"frame {t} of {footage.frames} ({stage})", done, total)

                if group:
                    group.append(fit_frame(trainer, target, group[-1], s, named))
                else:
                    group.append(fit_keyframe(trainer, target, footage, s, named))
            coded, *others = (v3_layout(group, qp, s.preset, s.form) for qp in s.qps)
            for i in range(max(0, done - start), len(group)):
                for qp, other in zip(s.qps[1:], others, strict=True):
                    place = footage.folder / f"qp{qp}"
                    place.mkdir(exist_ok=True)
                    write_ply(frame_path(place, start + i), other.frames[i])
                    write_json(place / f"{start + i}.json", other.frame_bytes[i])
                yield Shown("frame" if i else "keyframe", coded.frames[i], coded.frame_bytes[i])


@dataclass(slots=True, eq=False)
class FieldDriven:
    """Gaussians that a field over space displaces: stage 1, means alone."""

    base: Parameters
    extent: float  # of the scene in world units
    seed: int
    settings: FieldSettings = field(default_factory=FieldSettings)
    _field: HashField = field(init=False)
    _places: Places = field(init=False)
    _adam: torch.optim.Adam = field(init=False)

    def __post_init__(self) -> None:
        means = self.base["means"].numpy()
        box = np.quantile(means, [BOX_SHARE, 1 - BOX_SHARE], axis=0) + np.array([[-1], [1]]) * BOX_MARGIN * self.extent
        self._field = HashField(self.settings, box, 3, zero=True, seed=self.seed)
        self._places = self._field.places(means)
        self._adam = torch.optim.Adam(self._field.parameters(), lr=FIELD_RATE, betas=BETAS)

    def current(self, after: float = 0.0) -> Parameters:
        moved = self.base["means"] + DISPLACEMENT * self.extent * self._field(self._places)
        return self.base | {"means": moved}

    def detached(self) -> Parameters:
        with torch.no_grad():
            return self.current()

    def watch(self) -> None:
        """None: rows are not added."""

    def penalty(self) -> float:
        return 0.0

    def step(self, iteration: int, iterations: int) -> None:
        for group in self._adam.param_groups:
            group["lr"] = FIELD_RATE * FIELD_LAST ** (iteration / iterations)
        self._adam.step()
        self._adam.zero_grad(set_to_none=True)


@dataclass(slots=True, eq=False)
class Finetuned(PerGaussian):
    """All attributes of the frame before and a residual to it, which its losses hold: stage 2."""

    losses: ResidualLoss | None = None

    def penalty(self) -> torch.Tensor | float:
        return self.losses(self.adam.parameters) if self.losses else 0.0


def fit_keyframe(
    trainer: Trainer, target: FrameViews, footage: Footage, settings: V3Settings, progress: Progress
) -> Gaussians:
    """A keyframe from scratch, without its Gaussians of lowest opacity, fine-tuned; rows in Morton order."""
    points = footage.points if target.frame == 0 else None  # they are of the first frame
    g = fit_first(trainer, target, points, progress=progress).gaussians
    kept = np.sort(np.argsort(-g.opacity_logits, kind="stable")[: max(1, round((1 - settings.pruned) * len(g)))])
    fitted = PerGaussian(from_gaussians(g.take(kept)), trainer.extent, PRUNED_RATES, **FIRST_REGULARISERS)
    schedule = _schedule(trainer, "after pruning", settings.finetune_iterations)
    optimise(fitted, target.views, schedule, _rng(settings, target.frame, 0), progress=progress)
    g = to_gaussians(fitted.detached())
    return g.take(morton_order(g.means, GRID_BITS))


def fit_frame(
    trainer: Trainer, target: FrameViews, before: Gaussians, settings: V3Settings, progress: Progress
) -> Gaussians:
    """The Gaussians of the frame before, moved by a field and then fine-tuned. The rows stay."""
    base = from_gaussians(before)
    rng = _rng(settings, target.frame, 1)
    field_driven = FieldDriven(base, trainer.extent, int(rng.integers(2**31)))
    stage = _schedule(trainer, "field", settings.field_iterations, 1.0)
    optimise(field_driven, target.views, stage, rng, progress=progress)
    start = {name: value - base[name] for name, value in field_driven.detached().items()}
    losses = ResidualLoss(base, settings.temporal, settings.entropy, int(rng.integers(2**31)), settings.form)
    tuned = Finetuned(base, trainer.extent, MOVING_RATES, start, losses=losses)
    stage = _schedule(trainer, "fine-tuning", settings.frame_iterations, settings.coarse)
    optimise(tuned, target.views, stage, rng, progress=progress)
    return to_gaussians(tuned.detached())


def _schedule(trainer: Trainer, stage: str, iterations: int, coarse: float = 0.0) -> Schedule:
    s = trainer.settings
    return Schedule(stage, iterations, lambda _: s.sh_degree, ssim_weight=s.ssim_weight, coarse=coarse)


def _rng(settings: V3Settings, frame: int, stage: int) -> np.random.Generator:
    return np.random.default_rng([settings.seed, frame, stage])
