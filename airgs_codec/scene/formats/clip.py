"""Clips: one file that holds many frames, or Gaussians that move by themselves and are baked to frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

from airgs_codec.errors import SceneError
from airgs_codec.scene.formats.axes import Axes
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.ply import PlyHeader

MOST_FRAMES = 1 << 18  # two and a half hours at 30 frames a second


@dataclass(frozen=True, slots=True)
class Bake:
    """How many frames a clip becomes. None: what its file says, else the default of its format."""

    fps: Fraction | None = None  # frames a second
    seconds: Fraction | None = None


@dataclass(frozen=True, slots=True)
class Clip:
    """An open clip, of which only headers are in memory. It can be pickled: each process keeps what it decodes."""

    headers: tuple[PlyHeader, ...]  # of the frames
    fps: Fraction  # frames a second
    read: Callable[[Path, int], Gaussians]  # a frame of its file, wherever that is, unrepaired; raises SceneError
    note: str  # what was read, and how it became frames, for people
    breaks: tuple[int, ...] = ()  # frames whose rows are known to be others than those of the frame before
    axes: Axes | None = None  # as the file says; None: it does not


def count_frames(path: Path, fps: Fraction, seconds: Fraction) -> int:
    """The frames of a clip of some length, at least one. Raises SceneError where they are too many, or none."""
    if not 0 < fps * seconds <= MOST_FRAMES:
        raise SceneError(f"{path}: expected a clip of 1 to {MOST_FRAMES} frames, got {float(seconds):g} s at {fps} fps")
    return max(1, round(fps * seconds))


def refuse_baking(path: Path, bake: Bake, name: str, *, fps: bool = True) -> None:
    """Raise SceneError where somebody asks for what a format leaves no choice in: the duration and, maybe, `fps`."""
    if bake.seconds is not None:
        raise SceneError(f"{path}: expected no duration, {name} states its own, got {float(bake.seconds):g} s")
    if fps and bake.fps is not None:
        raise SceneError(f"{path}: expected no frame rate to bake at, {name} has whole frames, got {bake.fps} fps")


def rate_words(fps: Fraction) -> str:
    """A frame rate for people."""
    return f"{float(fps):g} a second"
