"""The settings that, with the scene, decide the bytes of a package."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from airgs_codec._settings import available_cores, documented, setting
from airgs_codec.analysis.grouping import DEFAULT_GROUP_FRAMES
from airgs_codec.analysis.rows import AUTO, ROWS
from airgs_codec.coding.motion import StepSettings
from airgs_codec.errors import ConfigError
from airgs_codec.media.h264 import DEFAULT_PRESET, DELTA_QP, KEYFRAME_QP, PRESETS
from airgs_codec.package.parse import fault_of, read_region
from airgs_codec.package.tables import GRID_BITS, MAX_CHOICES, Region, World
from airgs_codec.scene.beside import MEASURES


@dataclass(frozen=True, slots=True)
class LevelSettings:
    """A level, and with its keyframe quality a rung of the ladder."""

    pruned: float  # share of the updates that is withheld
    factor: float = 1.0  # on the delta steps
    tiers: int = 0  # keyframe tiers that its viewers fetch; 0: all
    quality: int = 0  # keyframe quality that its deltas correct

    @property
    def words(self) -> str:
        """Pruned percentage and factor, as options have them."""
        return f"{self.pruned * 100:g}:{self.factor:g}"


def read_levels(text: str) -> tuple[LevelSettings, ...]:
    """Read levels: '0:1,30:1.5' has a second one with 30 % withheld and steps times 1.5.

    Raises ConfigError.
    """
    try:
        pairs = [part.split(":") for part in text.split(",")]
        return tuple(LevelSettings(float(pruned) / 100, float(factor)) for pruned, factor in pairs)
    except ValueError as error:
        raise ConfigError(f"expected PRUNED:FACTOR,…, got {text!r}") from error


def read_quality(text: str) -> float:
    """Return the factor that a name stands for, or that the text is. Raises ConfigError."""
    try:
        return QUALITY_FACTORS[text] if text in QUALITY_FACTORS else float(text)
    except ValueError as error:
        raise ConfigError(f"expected {', '.join(QUALITY_FACTORS)} or a number, got {text!r}") from error


Shares = tuple[tuple[float, float], ...]  # (factor on the steps, share of the updates to withhold), ascending

DEFAULT_LEVELS = (
    LevelSettings(0.0, 1.0),
    LevelSettings(0.3, 1.5),
    LevelSettings(0.5, 2.0, quality=1),
    LevelSettings(0.6, 3.0, quality=1),
)
FAST_LEVELS = (LevelSettings(0.0, 1.0), LevelSettings(0.5, 2.0, quality=1))
PAPER_LEVELS = tuple(LevelSettings(share / 10) for share in range(11))  # the last one holds the keyframe
QUALITY_FACTORS = {"low": 1.6, "medium": 1.0, "high": 0.6}
UPDATE_RANKS = ("error", "usage", "hits")
CELL_GROWTH = 0.75  # cells of positions grow with this power of the keyframe factor: ever fewer rows are updated
KEYFRAMES = ("inter", "intra")
INTER, INTRA = KEYFRAMES
DEFAULT_TIERS = (0.8, 0.2)  # core, rest
CALIBRATIONS = ("ladder", "steps", "none")


@documented
@dataclass(frozen=True, slots=True)
class EncodeSettings:
    """Everything that, with the scene, decides the bytes of a package.

    Raises ConfigError, when it is made, for values that cannot work.
    """

    quality: float = setting(
        1.0,
        "factor on every quantiser step; smaller is finer and takes more bytes: low is 1.6, medium 1, high 0.6",
        read=read_quality,
        metavar="low|medium|high|X",
    )
    calibrate: str = setting(
        "ladder",
        "what trial encodes of the scene decide, stored for the next time: quantiser steps, levels and tiers (ladder, "
        "which asks for the default levels and tiers), the steps alone (steps), or nothing (none)",
        choices=CALIBRATIONS,
    )
    levels: tuple[LevelSettings, ...] = setting(
        DEFAULT_LEVELS,
        "for each level the percentage of the updates withheld and a factor on the steps; percentages (as text, shares "
        "of 0 to 1 here) ascend, then the number of keyframe tiers, descending, and the keyframe quality, ascending",
        read=read_levels,
        metavar="PRUNED:FACTOR,…",
        default=",".join(level.words for level in DEFAULT_LEVELS),
    )
    tiers: tuple[float, ...] = setting(DEFAULT_TIERS, "share of the Gaussians in each keyframe tier, summing to 1")
    shares: Shares = setting(
        tuple,
        "(factor on the steps, share of the updates to withhold), ascending; calibration finds them",
        option=False,
    )
    keyframe_factors: tuple[float, ...] = setting(
        (1.0, 3.0), "for each keyframe quality a factor on the keyframe steps; cells of positions grow with it"
    )
    steps: StepSettings = setting(StepSettings, "quantiser steps at quality 1; calibration starts there", option=False)
    segment_s: float = setting(1.0, "longest delta segment, in seconds")
    group_frames: int = setting(
        DEFAULT_GROUP_FRAMES,
        "most frames of a group, which share a keyframe; runs of frames are cut into groups of about equal length; it "
        "counts where no keyframes are given",
    )
    rows: str = setting(
        AUTO,
        "rows of frames that are not tracked: matched with those of the frame before where they lost their order, or "
        "else coded frame by frame (auto); taken as they are (keep); or matched whether they look lost or not (match)",
        choices=ROWS,
    )
    keyframes: str = setting(
        INTER,
        "how the keyframe of a group is coded: by its difference to that of an earlier group where that is smaller "
        "(inter), or always by itself (intra)",
        choices=KEYFRAMES,
    )
    margin: float | None = setting(
        None,
        "how far a viewer may go from the scene's cameras, in world units; by default a quarter of the largest "
        "distance between two of them, or a tenth of the distance to the content if that is more, but at most "
        "a quarter of it",
    )
    region: Region | None = setting(
        None,
        "where the scene may be looked at from, instead of about its cameras: JSON as `region` in airgs.json",
        read=lambda text: read_region(Path(text)),
        metavar="FILE",
    )
    world: World | None = setting(
        None,
        "which way is up and how long a unit is (`package.region.world_from`), for players; by default what the format "
        "of the frames specifies",
        option=False,
    )
    usage: str = setting(
        "importance",
        "what ranks Gaussians for keyframe tiers: the largest blending weight alpha T (max), the sum of these weights "
        "(sum), the number of pixels blended (hits, literally as in the paper), or max x sum x the error of leaving "
        "the Gaussian out (importance)",
        choices=MEASURES,
    )
    update_rank: str = setting(
        "error",
        "what ranks updates for pruning: the error expected of withholding one (error), usage x the size of the "
        "change (usage), or the number of pixels blended alone, whatever ranks Gaussians, as in the paper (hits)",
        choices=UPDATE_RANKS,
    )
    keep_all: bool = setting(False, "leave nothing out but what is constant")
    decide_pictures: int = setting(24, "pictures of each group that decide what matters, at least")
    check_pictures: int = setting(16, "others, which show what leaving something out would do", option=False)
    byte_price: float = setting(
        0.0,
        "squared error of pictures that must be worth a byte a frame at quality 1, or planes and segments are left "
        "out; 0: none are; calibration finds it",
        option=False,
    )
    measure_pictures: int = setting(
        64, "most pictures that measure quality, spread over all frames; fewer where 0.15 dB are sure; 0: none"
    )
    preset: str = setting(DEFAULT_PRESET, "x264 preset", name="x264-preset", choices=PRESETS)
    threads: int = setting(
        available_cores,
        "representations of a group encoded at the same time; the bytes are the same",
        default="one a core, shared by --jobs",
    )
    device: str = setting(
        "auto",
        "where pictures that decide and measure are drawn: cpu, cuda, or auto, cuda where gsplat can run",
        option=False,
    )

    def __post_init__(self) -> None:
        shares = [level.pruned for level in self.levels]
        tiers = [self.tiers_of(level) for level in self.levels]
        qualities = [level.quality for level in self.levels]
        ladder = (self.levels, self.tiers)
        fault = fault_of(self.world.transform) if self.world else None
        others = [*self.keyframe_factors, *(level.factor for level in self.levels)]
        factors = [self.quality, *others, *(self.quality * factor for factor in others)]
        checks = [
            (1 <= len(self.levels) <= MAX_CHOICES, f"expected 1 to {MAX_CHOICES} levels"),
            (all(0 <= s <= 1 for s in shares), f"expected pruned shares in [0, 1], got {shares}"),
            (shares == sorted(shares), f"expected ascending pruned shares, got {shares}"),
            (
                tiers[:1] == [len(self.tiers)] and tiers == sorted(tiers, reverse=True) and tiers[-1] > 0,
                f"expected descending keyframe tiers from {len(self.tiers)} on, got {tiers}",
            ),
            (
                qualities == sorted(qualities) and all(0 <= q < len(self.keyframe_factors) for q in qualities),
                f"expected ascending keyframe qualities below {len(self.keyframe_factors)}, got {qualities}",
            ),
            (all(1e-6 <= factor <= 1e6 for factor in factors), "expected step factors of 1e-06 to 1e+06"),
            (0 < self.segment_s < math.inf, f"expected a positive segment length, got {self.segment_s}"),
            (self.group_frames >= 1, f"expected at least one frame a group, got {self.group_frames}"),
            (abs(sum(self.tiers) - 1) < 1e-9, f"expected tiers that sum to 1, got {self.tiers}"),
            (min(self.tiers) >= 0, f"expected tiers of 0 or more, got {self.tiers}"),
            (
                self.calibrate != "ladder" or ladder == (DEFAULT_LEVELS, DEFAULT_TIERS),
                'levels and tiers would be replaced: expected calibrate "steps" or "none" with them',
            ),
            (self.margin is None or self.region is None, "expected a margin or a region, got both"),
            (not fault, f"world: {fault}"),
            (self.decide_pictures >= 1, f"expected 1 or more pictures to decide with, got {self.decide_pictures}"),
            (self.check_pictures >= 1, f"expected 1 or more pictures to check with, got {self.check_pictures}"),
            (self.measure_pictures >= 0, f"expected 0 or more pictures to measure, got {self.measure_pictures}"),
            (self.threads >= 1, f"expected at least one thread, got {self.threads}"),
        ]
        for good, message in checks:
            if not good:
                raise ConfigError(message)

    @property
    def coarser(self) -> tuple[int, ...]:
        """For each keyframe quality the power of 2 by which its cells of canonical means are wider than the finest."""
        powers = [round(CELL_GROWTH * math.log2(factor / self.keyframe_factors[0])) for factor in self.keyframe_factors]
        return tuple(min(power, GRID_BITS) for power in itertools.accumulate(powers, max))

    @property
    def row_error(self) -> float | None:
        """Error of pictures that leaving out rows may make (RMS, samples in 0..1); None: none are left out."""
        return None if self.keep_all else self.steps.rows * self.quality

    @property
    def scaled_price(self) -> float:
        """`byte_price` at this quality: error grows with the square of the steps. 0 where nothing is left out."""
        return 0.0 if self.keep_all else self.byte_price * self.quality**2

    def at(self, quality: float) -> EncodeSettings:
        """Return the settings at another quality; levels withhold what `shares` says for their steps."""
        if not self.shares:
            return replace(self, quality=quality)
        levels = (replace(level, pruned=round(self._share(quality * level.factor), 3)) for level in self.levels)
        return replace(self, quality=quality, levels=tuple(levels))

    def _share(self, factor: float) -> float:
        """Return the share of updates to withhold at a factor on the steps, between those of the nearest two factors.

        A share that jumped would make quality jump, and a target in the gap could not be reached.
        """
        factors, shares = np.array(self.shares).T
        return float(np.interp(math.log(factor), np.log(factors), shares))

    def tiers_of(self, level: LevelSettings) -> int:
        """Return the number of keyframe tiers that viewers of a level fetch."""
        return level.tiers or len(self.tiers)

    @property
    def words(self) -> str:
        return f"levels {','.join(level.words for level in self.levels)} at quality {self.quality:.3g}"

    def table(self) -> dict[str, str]:
        """Return settings as text, for the record in airgs.json."""
        return {
            "levels": ",".join(level.words for level in self.levels),
            "keyframe_factors": ",".join(f"{factor:g}" for factor in self.keyframe_factors),
            "quality": f"{self.quality:g}",
            "rows": self.rows,
            "keyframes": self.keyframes,
            "usage": self.usage,
            "rank": self.update_rank,
            "codec": "libx264",
            "preset": self.preset,
            "keyframe_qp": str(KEYFRAME_QP),
            "delta_qp": str(DELTA_QP),
        }


def as_in_paper(settings: EncodeSettings) -> EncodeSettings:
    """Return the paper's levels: updates ranked by usage frequency, 0 to 100 % pruned, equal steps, one keyframe."""
    return replace(
        settings,
        calibrate="none",
        levels=PAPER_LEVELS,
        tiers=(1.0,),
        keyframe_factors=(1.0,),
        usage="hits",
        update_rank="hits",
        keep_all=True,
        keyframes=INTRA,
    )


def as_fast(settings: EncodeSettings) -> EncodeSettings:
    """For results soon: no trial encodes, x264's preset fast, few pictures, few levels."""
    return replace(
        settings,
        levels=settings.levels if settings.levels != DEFAULT_LEVELS else FAST_LEVELS,
        calibrate="none",
        preset="fast",
        decide_pictures=8,
        check_pictures=8,
        measure_pictures=min(settings.measure_pictures, 8),
    )


DEFAULT_SETTINGS = EncodeSettings()
