"""What decides the bytes of a package besides the scene."""

from __future__ import annotations

import os
from dataclasses import dataclass, field

from airgs_codec.analysis.grouping import DEFAULT_GROUP_FRAMES
from airgs_codec.coding.steps import StepSettings
from airgs_codec.encoder.levels import DEFAULT_TIERS
from airgs_codec.errors import ConfigError
from airgs_codec.media.h264 import DEFAULT_PRESET, KEY_QP, PRESETS, STATE_QP
from airgs_codec.package.tables import MAX_CHOICES
from airgs_codec.scene.usage import MEASURES

DEFAULT_LEVELS = ((0.0, 1.0), (0.3, 1.5), (0.5, 2.0), (0.6, 3.0))
RANKS = ("error", "usage")  # expected error of withholding an update; usage x size of its change
PAPER_LEVELS = tuple((share / 10, 1.0) for share in range(10))
QUALITY_FACTORS = {"low": 1.6, "medium": 1.0, "high": 0.6}


@dataclass(frozen=True, slots=True)
class EncodeSettings:
    """Everything that decides the bytes of a package besides the scene."""

    levels: tuple[tuple[float, float], ...] = DEFAULT_LEVELS  # pruned share, step factor
    core_levels: int = 0  # the last of them, which do with the first key tier
    key_factors: tuple[float, ...] = (1.0, 3.0)
    tiers: tuple[float, ...] = DEFAULT_TIERS
    steps: StepSettings = field(default_factory=StepSettings)
    quality: float = 1.0  # factor on every step
    segment_s: float = 1.0
    group_frames: int = DEFAULT_GROUP_FRAMES
    usage: str = "importance"  # what key tiers are ranked by
    rank: str = "error"  # what updates are ranked by, of RANKS
    keep_all: bool = False  # leave nothing out but what is constant
    price: float = 0.0  # squared error of pictures that a byte a frame must save, at quality 1; 0: no plane pays
    preset: str = DEFAULT_PRESET
    jobs: int = field(default_factory=lambda: os.cpu_count() or 1)

    def __post_init__(self) -> None:
        shares = [share for share, _ in self.levels]
        checks = [
            (1 <= len(self.levels) <= MAX_CHOICES, f"expected 1 to {MAX_CHOICES} levels"),
            (all(0 <= s < 1 for s in shares), f"expected pruned shares in [0, 1), got {shares}"),
            (shares == sorted(shares), f"expected ascending pruned shares, got {shares}"),
            (0 <= self.core_levels < len(self.levels), f"expected 0 to {len(self.levels) - 1} core levels"),
            (all(f > 0 for _, f in self.levels) and self.quality > 0, "expected positive step factors"),
            (self.segment_s > 0, f"expected a positive segment length, got {self.segment_s}"),
            (self.group_frames >= 1, f"expected at least one frame a group, got {self.group_frames}"),
            (
                abs(sum(self.tiers) - 1) < 1e-9 and min(self.tiers) >= 0,
                f"expected tiers that sum to 1, got {self.tiers}",
            ),
            (self.usage in MEASURES, f"expected usage {', '.join(MEASURES)}, got {self.usage}"),
            (self.rank in RANKS, f"expected rank {', '.join(RANKS)}, got {self.rank}"),
            (self.preset in PRESETS, f"expected an x264 preset, got {self.preset}"),
            (self.jobs >= 1, f"expected at least one job, got {self.jobs}"),
        ]
        for good, message in checks:
            if not good:
                raise ConfigError(message)

    @property
    def byte_price(self) -> float:
        """The price at this quality: error grows with the square of the steps."""
        return 0.0 if self.keep_all else self.price * self.quality**2

    def tiers_of(self, level: int) -> int:
        """Key tiers that viewers of a level fetch."""
        return 1 if level >= len(self.levels) - self.core_levels else len(self.tiers)

    def table(self) -> dict[str, str]:
        """Settings as text, for the record in airgs.json."""
        return {
            "levels": ",".join(f"{share * 100:g}:{factor:g}" for share, factor in self.levels),
            "core_levels": str(self.core_levels),
            "key_factors": ",".join(f"{factor:g}" for factor in self.key_factors),
            "quality": f"{self.quality:g}",
            "usage": self.usage,
            "rank": self.rank,
            "codec": "libx264",
            "preset": self.preset,
            "key_qp": str(KEY_QP),
            "state_qp": str(STATE_QP),
        }
