"""A format of splat files as a value: what reads and writes it, what it can hold, and which way is up in it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from airgs_codec.errors import SceneError
from airgs_codec.scene.frames import repair
from airgs_codec.scene.gaussians import SH_REST, Gaussians

MOST_FRAMES = 1 << 18  # two and a half hours at 30 frames a second
SIZES = ("log_scales", -87.0, 88.0)  # the range of sizes that are neither 0 nor infinite in float32
SPARE_ROWS = 1 << 16  # that a file may have beyond one a byte: no format stores a Gaussian in less
_WORDS = {"means": "positions", "log_scales": "sizes", "sh_dc": "colours", "sh_rest": "SH"}


@dataclass(frozen=True, slots=True)
class FrameHeader:
    """The count and SH degree that the header of a frame promises."""

    count: int
    sh_degree: int  # 0..3

    @property
    def bytes(self) -> int:
        return 4 * self.count * (14 + 3 * SH_REST[self.sh_degree])


@dataclass(frozen=True, slots=True)
class Axes:
    """The direction that points up in the coordinates of a file, and how long a unit is."""

    up: tuple[float, ...]  # (3,)
    metres: float | None = None  # None: nothing says it


@dataclass(frozen=True, slots=True)
class Holds:
    """The limits of what files of a format hold; by default all that Gaussians have, in float32."""

    sh_degree: int = 3
    rounding: str = ""  # what is rounded to how many bits
    keeps_rows: bool = True  # whether row n is the same Gaussian in all frames
    doubles: bool = False  # whether positions may be float64
    ranges: tuple[tuple[str, float, float], ...] = ()  # an attribute of Gaussians, its least and largest value


@dataclass(frozen=True, slots=True)
class Bake:
    """How many frames a clip becomes; None: what its file says, else the default of its format."""

    fps: Fraction | None = None  # frames a second
    seconds: Fraction | None = None


@dataclass(frozen=True, slots=True)
class Clip:
    """An open clip, of which only headers are in memory. It can be pickled: each process caches what it decodes."""

    headers: tuple[FrameHeader, ...]  # of the frames
    fps: Fraction  # frames a second
    read: Callable[[Path, int], Gaussians]  # a frame of its file, as `FrameFormat.read`; raises SceneError
    note: str  # what was read, and how it became frames, for people


@dataclass(frozen=True, slots=True)
class FrameFormat:
    """A format of files that hold one frame; its functions raise SceneError or what `files.expecting` knows."""

    name: str
    key: str  # in options; written files end in it, after a dot
    suffixes: tuple[str, ...]  # of files that are read
    read_header: Callable[[Path], FrameHeader]
    read: Callable[[Path], Gaussians]  # its positions may be float64
    write: Callable[[Path, Gaussians], None]  # of Gaussians as `holds` makes them fit
    holds: Holds = Holds()
    signs: tuple[str, ...] = ()  # vertex properties of which a .ply of this format has one; none: any other is of it
    axes: Axes | None = None  # as its specification says; None: it does not, or files do not keep to it


@dataclass(frozen=True, slots=True)
class ClipFormat:
    """A format of files that hold many frames, or Gaussians that move by themselves and are baked to frames."""

    name: str
    suffixes: tuple[str, ...]
    open: Callable[[Path, Bake], Clip]  # raises SceneError
    signs: tuple[str, ...] = ()  # as of FrameFormat


def check_count(path: Path, header: FrameHeader) -> FrameHeader:
    """Return the header if a file of this size can hold its count. Raises SceneError, before memory is taken."""
    size = path.stat().st_size
    if not 0 <= header.count <= size + SPARE_ROWS:
        raise SceneError(f"{path}: expected as many Gaussians as {size} bytes can hold, got {header.count}")
    return header


def count_frames(path: Path, fps: Fraction, seconds: Fraction) -> int:
    """Return the number of frames of a clip of some length. Raises SceneError where they are too many, or none."""
    if not 0 < fps * seconds <= MOST_FRAMES:
        raise SceneError(f"{path}: expected a clip of 1 to {MOST_FRAMES} frames, got {float(seconds):g} s at {fps} fps")
    return max(1, round(fps * seconds))


class Losses:
    """What frames lose so that they fit a format."""

    def __init__(self, holds: Holds, form: str) -> None:
        self._holds, self._form = holds, form
        self._frames = self._rows = self._degree = 0
        self._beyond: Counter[str] = Counter()
        self._notes: list[str] = []

    def fit(self, gaussians: Gaussians, where: str) -> Gaussians:
        """Return the frame with unit quaternions, no SH above the degree of the format, and values within its ranges.

        Raises SceneError, which names the frame by `where`, as `repair` does.
        """
        repaired = repair([gaussians], where)
        g = repaired.frames[0]
        self._notes += repaired.notes
        self._frames, self._rows, self._degree = self._frames + 1, self._rows + len(g), max(self._degree, g.sh_degree)
        g = g.with_degree(min(g.sh_degree, self._holds.sh_degree))
        for name, low, high in self._holds.ranges:
            values = getattr(g, name)
            beyond = ((values < low) | (values > high)).reshape(len(g), -1).any(axis=1)
            self._beyond[name] += int(beyond.sum())
            g = replace(g, **{name: np.clip(values, np.float32(low), np.float32(high))}) if beyond.any() else g
        return g

    def lines(self) -> list[str]:
        """Return a line for each kind of loss, none where nothing was lost."""
        holds, lost = self._holds, list[str]()
        if self._degree > holds.sh_degree:
            lost.append(f"has SH of degree {holds.sh_degree} at most, of {self._degree}")
        if holds.rounding:
            lost.append(f"rounds {holds.rounding}")
        if not holds.keeps_rows and self._frames > 1:
            lost.append("has rows in another order in every frame: which Gaussian is which is lost")
        for name, low, high in holds.ranges:
            if count := self._beyond[name]:
                share = f"{count} of {self._rows} Gaussians"
                lost.append(f"has {_WORDS[name]} from {low:.4g} to {high:.4g}: cut off in {share}")
        return self._notes + [f"{self._form} {line}" for line in lost]
