"""A Gaussian sequence on disk: a folder of .ply frames, optional sequence.json and transforms.json."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError
from airgs_codec.scene.camera import Camera, read_cameras
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.ply import PlyHeader, read_ply, read_ply_header
from airgs_codec.scene.usage import Usage, load_usage

DEFAULT_FPS = Fraction(30)
USAGE_NAME = "usage.npz"
OPACITY_LOGIT_LIMIT = np.float32(20.0)  # sigmoid(20) = 1 - 2e-9; an infinite logit is stored as this
QUATERNION_MIN_NORM = 1e-12  # below it the squared length leaves float32: no direction to read


@dataclass(frozen=True, slots=True)
class GaussianSequence:
    """Frames in display order; nothing is read from them but their headers."""

    folder: Path
    paths: tuple[Path, ...]
    headers: tuple[PlyHeader, ...]
    fps: Fraction
    keyframes: tuple[int, ...] | None  # first frames of groups, when sequence.json names them
    cameras: tuple[Camera, ...]  # empty: none given
    most_bands: int = 3  # SH bands past DC that are read

    @property
    def sh_degree(self) -> int:
        """The SH degree of every frame as it is read."""
        return min(self.headers[0].sh_degree, self.most_bands)

    def __len__(self) -> int:
        return len(self.paths)

    def usage(self, start: int, stop: int) -> Usage | None:
        """What the trainer measured of the group [start, stop) over all its frames, if it left that."""
        path = self.folder / USAGE_NAME
        return load_usage(path, start, stop) if path.is_file() else None

    def read(self, frame: int) -> Gaussians:
        """The frame as its file has it, unrepaired. Raises SceneError."""
        return read_ply(self.paths[frame]).with_degree(self.sh_degree)

    def load(self, frames: Iterable[int]) -> Repaired:
        """Some frames of one group, repaired together: a row dropped in one is dropped in all. Raises SceneError."""
        numbers = list(frames)
        span = f"frame {numbers[0]}" if len(numbers) == 1 else f"frames {numbers[0]}-{numbers[-1]}"
        return repair([self.read(i) for i in numbers], f"{self.folder.name} {span}")


def open_sequence(folder: Path, *, views: Path | None = None, fps: Fraction | None = None) -> GaussianSequence:
    """The sequence in `folder`. `views` and `fps` take precedence over transforms.json and sequence.json.

    Raises SceneError: no folder, no frames, a frame that is no Gaussian .ply or has no rows, a changed SH degree.
    """
    if not folder.is_dir():
        raise SceneError(
            f"{folder}: expected a folder of .ply frames, got {'a file' if folder.exists() else 'nothing'}"
        )
    paths = tuple(sorted(folder.glob("*.ply"), key=natural_key))
    if not paths:
        raise SceneError(f"{folder}: expected at least one .ply frame, got none")
    headers = tuple(read_ply_header(path) for path in paths)
    for path, header in zip(paths, headers, strict=True):
        if header.count == 0:
            raise SceneError(f"{path}: expected at least one Gaussian, got none")
        if header.sh_degree != headers[0].sh_degree:
            expected = f"expected SH degree {headers[0].sh_degree} as in {paths[0].name}"
            raise SceneError(f"{path}: {expected}, got {header.sh_degree}")
    settings = _read_settings(folder / "sequence.json", len(paths))
    cameras_path = views or folder / "transforms.json"
    cameras = tuple(read_cameras(cameras_path)) if views or cameras_path.exists() else ()
    return GaussianSequence(folder, paths, headers, fps or settings[0], settings[1], cameras)


def natural_key(path: Path) -> list[tuple[int, str]]:
    """Sort key that puts frame2 before frame10."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", path.stem) if part]


def _read_settings(path: Path, frames: int) -> tuple[Fraction, tuple[int, ...] | None]:
    if not path.exists():
        return DEFAULT_FPS, None
    try:
        data: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        fps = Fraction(str(data.get("fps", DEFAULT_FPS)))
        keyframes = data.get("keyframes")
        starts = None if keyframes is None else tuple(sorted({0, *(int(k) for k in keyframes)}))
    except (OSError, ValueError, TypeError, AttributeError, ZeroDivisionError) as error:
        raise SceneError(f'{path}: expected {{"fps": number, "keyframes": [frame, ...]}}, got {error}') from error
    if not 0 < fps <= 1000:
        raise SceneError(f"{path}: expected 0 < fps <= 1000, got {fps}")
    if starts and not (starts[0] >= 0 and starts[-1] < frames):
        raise SceneError(f"{path}: expected keyframes in 0..{frames - 1}, got {list(starts)}")
    return fps, starts


@dataclass(frozen=True, slots=True, eq=False)
class Repaired:
    """Frames that share rows, after the documented repairs; `notes` says what was mended."""

    frames: list[Gaussians]
    notes: list[str]


def repair(frames: list[Gaussians], where: str) -> Repaired:
    """Make frames of one group codable.

    Infinite opacity logits become +-20, zero quaternions identity; a row that is not finite in any frame is dropped
    in all of them. Raises SceneError when no row is left.
    """
    notes: list[str] = []
    frames = [_repair_opacity(frame) for frame in frames]
    finite = np.logical_and.reduce([_finite_rows(frame) for frame in frames])
    if not finite.all():
        notes.append(f"{where}: {int((~finite).sum())} Gaussians that are not finite in some frame were dropped")
        frames = [frame.take(finite) for frame in frames]
    if not finite.any():
        raise SceneError(f"{where}: expected finite Gaussians, all {len(finite)} have NaN or Inf in some frame")
    zero = [np.linalg.norm(frame.quaternions.astype(np.float64), axis=1) < QUATERNION_MIN_NORM for frame in frames]
    if count := int(np.logical_or.reduce(zero).sum()):
        notes.append(f"{where}: {count} Gaussians with zero quaternions were given identity")
    frames = [_with_unit_quaternions(f, z) for f, z in zip(frames, zero, strict=True)]
    return Repaired(frames, notes)


def _repair_opacity(g: Gaussians) -> Gaussians:
    logits = np.where(np.isinf(g.opacity_logits), np.sign(g.opacity_logits) * OPACITY_LOGIT_LIMIT, g.opacity_logits)
    return Gaussians(g.means, g.quaternions, g.log_scales, logits.astype(np.float32), g.sh_dc, g.sh_rest)


def _finite_rows(g: Gaussians) -> NDArray[np.bool_]:
    columns = (g.means, g.quaternions, g.log_scales, g.opacity_logits[:, None], g.sh_dc, g.sh_rest.reshape(len(g), -1))
    return np.logical_and.reduce([np.isfinite(column).all(axis=1) for column in columns])


def _with_unit_quaternions(g: Gaussians, zero: NDArray[np.bool_]) -> Gaussians:
    q = np.where(zero[:, None], np.array([1, 0, 0, 0], np.float32), g.quaternions).astype(np.float64)
    unit = (q / np.linalg.norm(q, axis=1, keepdims=True)).astype(np.float32)
    return Gaussians(g.means, unit, g.log_scales, g.opacity_logits, g.sh_dc, g.sh_rest)
