"""Everything that decides a training run except the pictures: the same settings give the same Gaussians."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

from airgs_codec._settings import documented, setting
from airgs_codec.analysis.rows import AUTO
from airgs_codec.errors import ConfigError
from airgs_codec.scene.camera import BLACK, Background
from airgs_codec.scene.gaussians import SH_REST

FIRST, FIRST_A_VIEW = 1500, 36  # iterations of a first frame: the larger of both
LEAST_BUDGET, MOST_BUDGET = 8_000, 64_000  # Gaussians of a first frame, where its pictures decide
DELTAS = ("direct", "mlp", "mlp+residual")
DELTAS_WORDS = "direct; mlp+residual on CUDA"
TRAIN_PRESETS = ("default", "paper")
ON, OFF = "on", "off"
MATCHES = (AUTO, ON, OFF)
UNITS = ("step", "sum", "gaussians", "elements")
DENSIFY = BUDGET, THRESHOLD = ("budget", "threshold")
RANDOM = "random"  # a background: another colour at every step
BACKGROUNDS: dict[str, Background] = {"black": BLACK, "white": (1.0, 1.0, 1.0)}


@dataclass(frozen=True, slots=True)
class Temporal:
    weight: float = setting(1e-3, "weight of changes from frame to frame; 0: none")
    unit: str = setting("step", "mean over Gaussians in codec steps; sum or mean of plain values", choices=UNITS)
    until: float = setting(0.65, "share of the iterations in which it acts, unless networks are fitted; then 0 stays 0")


BOUNDS: tuple[tuple[float, float, str], ...] = (  # least, most, and the settings that have them
    (0, math.inf, "weight min_psnr_db max_growth inflation seed"),
    (1, math.inf, "budget first_iterations keyframe_iterations frame_iterations group_frames iteration_views"),
    (16, math.inf, "max_size"),
    (0, 1, "coarse ssim_weight"),
    (0, len(SH_REST) - 1, "sh_degree"),
)


@documented
@dataclass(frozen=True, slots=True)
class TrainSettings:
    """The settings of a run. Raises ConfigError for values that cannot work."""

    budget: int | None = setting(
        None, f"Gaussians of the first frame, {LEAST_BUDGET} to {MOST_BUDGET}", default="by the size of the pictures"
    )
    capacity: int | None = setting(None, "most Gaussians that there may ever be", default="1.5 times the first frame's")
    sh_degree: int = setting(1, "degree of the spherical harmonics, 0 to 3")
    first_iterations: int | None = setting(
        None, "iterations of the first frame", default=f"{FIRST}, at least {FIRST_A_VIEW} a view"
    )
    keyframe_iterations: int = setting(1000, "iterations of a keyframe")
    frame_iterations: int = setting(200, "iterations of a frame in a group")
    iteration_views: int = setting(1, "pictures that an iteration sees", default="1; 4 on CUDA")
    deltas: str = setting(
        DELTAS[0], "how frames move: Gaussian by Gaussian, by six MLPs, or both", choices=DELTAS, default=DELTAS_WORDS
    )
    coarse: float = setting(
        0.6, "share of iterations, the first ones, that see pictures of half the size; 0.4 times it in a first frame"
    )
    ssim_weight: float = setting(0.4, "share of 1 - SSIM in the loss of a picture; the rest is the absolute difference")
    regularised: bool = setting(True, "weigh opacity and scale in the loss of a first frame, so that space stays empty")
    group_frames: int | None = setting(
        None, "frames of a chunk, which starts from the first frame, not from the frame before", default="one chunk"
    )
    temporal: Temporal = setting(Temporal, "weight, unit and end of the temporal loss", option=False)
    velocity: bool = setting(True, "start a frame where its Gaussians would be if they moved on as before")
    min_psnr_db: float = setting(
        0.0, "mean PSNR over training views below which a frame becomes a keyframe in any case"
    )
    max_drop_db: float = setting(
        3.0, "loss against the second frame of its group, or for that the first, above which a frame becomes a keyframe"
    )
    keep_better: bool = setting(True, "take a fit only where it shows more than what it starts from or replaces")
    seeds: bool = setting(True, "place new Gaussians of a keyframe where the views show what the present ones cannot")
    densify: str = setting(
        BUDGET,
        "split or clone the strongest Gaussians up to the budget, or all above 3DGS's threshold",
        choices=DENSIFY,
    )
    max_growth: float = setting(0.3, "most Gaussians that a keyframe adds, as a share of those it starts from")
    inflation: float = setting(1e-6, "weight of the summed opacity of what a keyframe adds")
    static: str = setting(
        "auto", "auto: what is at rest before still cameras stays as it is; off: all may change", choices=(AUTO, OFF)
    )
    max_size: int | None = setting(
        None, "longest side of the pictures in pixels; larger ones are shrunk", metavar="PX", default="as they are"
    )
    background: str | None = setting(
        None, "what is behind the scene: black, white, R,G,B or, for pictures with alpha, random at every step",
        metavar="COLOUR", default="the scene's own, else black",
    )  # fmt: skip
    foreground: str = setting(OFF, "train all, or only what the scene's masks show (given)", choices=(OFF, "given"))
    match_exposure: str = setting(
        "auto", "find a gain and an offset for each camera at the first frame; auto: where they differ", choices=MATCHES
    )
    reference: str | None = setting(
        None, "camera of the exposure that the Gaussians have", metavar="CAMERA", default="the average of all"
    )
    seed: int = setting(0, "seed of all random numbers")

    def __post_init__(self) -> None:
        named_background(self.background)
        values = asdict(self) | asdict(self.temporal)
        for one in (*fields(self), *fields(self.temporal)):
            if values[one.name] not in (known := one.metadata.get("choices", [values[one.name]])):
                raise ConfigError(f"expected {one.name} {', '.join(known)}, got {values[one.name]}")
        for least, most, names in BOUNDS:
            for name in names.split():
                if (value := values[name]) is not None and not (least <= value <= most and value < math.inf):
                    bounds = f"at least {least}" if most == math.inf else f"{least} to {most}"
                    raise ConfigError(f"expected {name} of {bounds}, got {value}")
        if not (0 < self.temporal.until <= 1 and self.max_drop_db > 0):
            words = f"got {self.temporal.until} and {self.max_drop_db}"
            raise ConfigError(f"expected until of 0 to 1 and max_drop_db above 0, {words}")
        if self.capacity is not None and self.capacity < (self.budget or 1):
            raise ConfigError(f"expected a capacity of at least the budget, got {self.capacity}")
        if self.match_exposure == ON and self.background == RANDOM:
            raise ConfigError("expected exposures to be matched or a random background, got both")
        if self.match_exposure == OFF and self.reference is not None:
            raise ConfigError(f"expected exposures to be matched where a camera is the reference, got {self.reference}")

    @property
    def finds_plates(self) -> bool:
        return self.static == AUTO and self.background != RANDOM

    @property
    def looks_for_exposure(self) -> bool:
        """Return whether exposures may be found to differ; a random background hides it."""
        return self.match_exposure == ON or (self.match_exposure == AUTO and self.background != RANDOM)

    def iterations_from_scratch(self, views: int) -> int:
        return max(FIRST, FIRST_A_VIEW * views) if self.first_iterations is None else self.first_iterations

    def table(self) -> dict[str, Any]:
        return asdict(self)


def named_background(text: str | None) -> Background | None:
    """Return the colour that a `background` names; None for None and RANDOM, which name none. Raises ConfigError."""
    if text is None or text == RANDOM:
        return None
    with suppress(ValueError):
        r, g, b = BACKGROUNDS[text] if text in BACKGROUNDS else map(float, text.split(","))
        if all(0 <= value <= 1 for value in (r, g, b)):
            return r, g, b
    raise ConfigError(f"expected a background of black, white, random or R,G,B of 0 to 1, got {text!r}")


def preset(name: str, settings: TrainSettings) -> TrainSettings:
    """Return the settings with those of a preset.

    `paper` is the paper's method with its constants (AirGS, "Training" 1 to 3). It does not say over what its temporal
    loss sums: here it is the mean over Gaussians, since a sum stops all motion. docs/results/training.md has the rest.
    """
    if name != "paper":
        return settings
    return replace(
        settings, deltas="mlp", temporal=Temporal(weight=1e-3, unit="gaussians", until=1.0),
        capacity=max(1_000_000, settings.capacity or 0), inflation=1e-5, densify=THRESHOLD, seeds=False,
        iteration_views=1, coarse=0.0, ssim_weight=0.2, regularised=False, velocity=False,
        min_psnr_db=30.0, max_drop_db=math.inf, keep_better=False, static=OFF, match_exposure=OFF,
    )  # fmt: skip
