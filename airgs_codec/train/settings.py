"""What decides a training run besides the scene."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any

from airgs_codec.errors import ConfigError
from airgs_codec.scene.gaussians import SH_REST
from airgs_codec.train.fit.temporal import UNITS, Temporal

DELTAS = ("direct", "mlp", "mlp+residual")
METHODS = ("airgs", "naive3dgs", "v3")
PRESETS = ("default", "paper")


@dataclass(frozen=True, slots=True)
class TrainSettings:
    """Everything that decides the Gaussians besides the pictures; the same settings give the same run."""

    method: str = "airgs"  # naive3dgs: every frame on its own; v3: groups of fixed length, keyframes from scratch
    budget: int = 8_000  # Gaussians of the first frame
    capacity: int = 12_000  # most Gaussians there may ever be
    sh_degree: int = 1
    first_iterations: int = 2500
    key_iterations: int = 1500
    frame_iterations: int = 300
    deltas: str = "direct"  # how frames in a group are fitted
    temporal: Temporal = field(default_factory=Temporal)
    tau: float = 30.0  # dB; a frame whose training views fall below starts a group
    drop: float = 5.0  # dB below the first frame of its group, which starts one too; inf: never
    added: float = 0.15  # of U, most Gaussians that a keyframe adds
    inflation: float = 1e-6  # lambda_inf
    group: int = 20  # frames, for v3
    max_size: int | None = None  # pixels, longest side
    foreground: bool = False
    match_exposure: bool = False  # find a gain and an offset a camera at the first frame
    seed: int = 0

    def __post_init__(self) -> None:
        checks = [
            (self.method in METHODS, f"expected method {', '.join(METHODS)}, got {self.method}"),
            (self.deltas in DELTAS, f"expected deltas {', '.join(DELTAS)}, got {self.deltas}"),
            (self.temporal.unit in UNITS, f"expected a temporal unit of {', '.join(UNITS)}, got {self.temporal.unit}"),
            (self.temporal.weight >= 0, f"expected a temporal weight of at least 0, got {self.temporal.weight}"),
            (self.budget >= 1, f"expected a budget of at least one Gaussian, got {self.budget}"),
            (self.capacity >= self.budget, f"expected a capacity of at least the budget, got {self.capacity}"),
            (0 <= self.sh_degree < len(SH_REST), f"expected an SH degree of 0 to 3, got {self.sh_degree}"),
            (min(self.first_iterations, self.key_iterations, self.frame_iterations) >= 1, "expected iterations"),
            (self.added >= 0 and self.inflation >= 0, "expected added and inflation of at least 0"),
            (self.drop > 0, f"expected a positive drop, got {self.drop}"),
            (self.group >= 1, f"expected at least one frame a group, got {self.group}"),
            (self.max_size is None or self.max_size >= 16, f"expected pictures of 16 pixels, got {self.max_size}"),
            (self.seed >= 0, f"expected a seed of at least 0, got {self.seed}"),
        ]
        for good, message in checks:
            if not good:
                raise ConfigError(message)

    def table(self) -> dict[str, Any]:
        """As JSON keeps it."""
        return asdict(self)


def preset(name: str, settings: TrainSettings) -> TrainSettings:
    """`paper`: the paper's method and constants, read literally where it gives no unit: it stops most motion."""
    if name == "paper":
        temporal = Temporal(weight=1e-3, unit="raw")
        return replace(settings, deltas="mlp", temporal=temporal, tau=30.0, drop=float("inf"), inflation=1e-5)
    return settings
