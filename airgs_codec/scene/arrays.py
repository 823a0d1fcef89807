"""Frames from arrays instead of files: checked as they come, and kept in memory or in a temporary folder.

T frames of N Gaussians; `Gaussians` gives the shapes of its columns.
"""

from __future__ import annotations

import shutil
import tempfile
import weakref
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec._arguments import described
from airgs_codec.errors import SceneError
from airgs_codec.scene.beside import frame_rate
from airgs_codec.scene.formats.form import Clip, FrameHeader
from airgs_codec.scene.formats.ply import read_ply, write_ply
from airgs_codec.scene.gaussians import Gaussians, as_floats

Frame = Gaussians | Mapping[str, Any]
NAMES = tuple(field.name for field in fields(Gaussians))
GSPLAT = dict(zip(("means", "quats", "scales", "opacities", "sh0", "shN"), NAMES, strict=True))  # as gsplat trains them
IN_MEMORY = Path("frames in memory")  # in place of a file


def clip_of(frames: Mapping[str, Any] | Iterable[Frame], fps: Fraction | float) -> Clip:
    """A clip of frames that are checked; those of an iterator go to a temporary folder, which goes with the clip.

    Raises SceneError, which names the frame and the attribute.
    """
    rate = frame_rate("fps", fps)
    stored: _Held | _Spilled = _Held() if isinstance(frames, Sequence | Mapping) else _Spilled()
    headers: list[FrameHeader] = []
    for number, frame in enumerate(_separate(frames)):
        g = _checked(frame, f"frame {number}")
        headers.append(FrameHeader(len(g), g.sh_degree))
        if g.sh_degree != headers[0].sh_degree:
            expected = f"expected SH degree {headers[0].sh_degree} as in frame 0"
            raise SceneError(f"frame {number}: sh_rest: {expected}, got {g.sh_degree}")
        stored.add(number, g)
    if not headers:
        raise SceneError("frames: expected at least one, got none")
    return Clip(tuple(headers), rate, stored.read, "frames from arrays")


def _separate(frames: Mapping[str, Any] | Iterable[Frame]) -> Iterator[Frame]:
    """The frames one after another; a mapping has arrays whose first axis is time."""
    if isinstance(frames, Mapping):
        columns = _ours({name: as_floats(name, value, name == NAMES[0]) for name, value in frames.items()}, "frames")
        shape = columns["means"].shape if "means" in columns else None
        if shape is None or len(shape) != 3:
            raise SceneError(f"means: expected an array of shape (T, N, 3), got {shape or 'none'}")
        for name, column in columns.items():
            if column.shape[:1] != shape[:1]:
                raise SceneError(f"{name}: expected {shape[0]} frames as of means, got the shape {column.shape}")
        yield from ({name: column[t] for name, column in columns.items()} for t in range(shape[0]))
    elif isinstance(frames, Iterable):
        yield from frames
    else:
        raise SceneError(f"frames: expected frames or a mapping of arrays with a time axis, got {described(frames)}")


def as_gaussians(value: Frame) -> Gaussians:
    """The argument `gaussians` of a function: Gaussians as they are, or a frame as `clip_of` takes it. SceneError."""
    return value if isinstance(value, Gaussians) else _checked(value, "gaussians")


def _ours(columns: dict[str, NDArray[np.float32]], where: str) -> dict[str, NDArray[np.float32]]:
    """The arrays under our names, where they have gsplat's. Raises SceneError where they may not be as it stores them.

    Its trainer stores logarithms and logits, as we do; its rasteriser takes sizes and opacities by the same names.
    """
    if not {*columns} <= {*GSPLAT} or {*columns} <= {*NAMES}:
        return columns
    sizes, alpha = (columns.get(name, np.zeros(0)) for name in ("scales", "opacities"))
    if sizes.size and alpha.size and sizes.min() > 0 and alpha.min() >= 0 and alpha.max() <= 1:
        expected = "expected logarithms of sizes and logits of opacities, as gsplat's trainer stores them"
        raise SceneError(f"{where}: scales, opacities: {expected}, got only sizes above 0 and opacities of 0 to 1")
    if (first := columns.get("sh0")) is not None and first.ndim > 2 and first.shape[-2] == 1:
        columns["sh0"] = first[..., 0, :]
    return {GSPLAT[name]: column for name, column in columns.items()}


def _checked(frame: Frame, where: str) -> Gaussians:
    if isinstance(frame, Gaussians):
        frame = {name: getattr(frame, name) for name in NAMES}
    if hasattr(frame, "items"):  # a dictionary of torch's parameters is no Mapping
        frame = dict(frame.items())
    if not isinstance(frame, Mapping):
        raise SceneError(f"{where}: expected Gaussians or a mapping of their arrays, got {described(frame)}")
    columns = {str(name): as_floats(f"{where}: {name}", value, name == NAMES[0]) for name, value in frame.items()}
    columns = _ours(columns, where)
    if not set(NAMES[:-1]) <= set(columns) <= set(NAMES):
        expected = f"expected {', '.join(NAMES[:-1])} and maybe {NAMES[-1]}"
        raise SceneError(f"{where}: {expected}, got {', '.join(map(str, frame)) or 'none'}")
    columns.setdefault(NAMES[-1], np.zeros((*columns["means"].shape[:1], 0, 3), np.float32))
    try:
        g = Gaussians(**columns)
    except SceneError as error:
        raise SceneError(f"{where}: {error}") from None
    if not len(g):
        raise SceneError(f"{where}: expected at least one Gaussian, got none")
    for name in NAMES:
        with np.errstate(over="ignore"):
            narrow = getattr(g, name).astype(np.float32, copy=False)  # what becomes infinite is refused
        finite = np.isfinite(narrow) | (name == "log_scales") & np.isneginf(narrow)
        if not finite.all():
            place = tuple(np.argwhere(~finite)[0].tolist())
            raise SceneError(f"{where}: {name}: expected finite numbers, got {columns[name][place]} in row {place[0]}")
    return g


class _Spilled:
    """Frames in a temporary folder of this process, which goes with it or sooner; others read them there."""

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = folder or Path(tempfile.mkdtemp(prefix="airgs-"))
        if folder is None:
            weakref.finalize(self, shutil.rmtree, self._folder, ignore_errors=True)

    def __reduce__(self) -> tuple[object, ...]:
        return _Spilled, (self._folder,)

    def add(self, number: int, frame: Gaussians) -> None:
        write_ply(self._path(number), frame)

    def read(self, _path: Path, number: int) -> Gaussians:
        return read_ply(self._path(number))

    def _path(self, number: int) -> Path:
        return self._folder / f"{number:06d}.ply"


class _Held:
    """Frames in memory. Other processes read them from a temporary folder, which goes with these."""

    def __init__(self) -> None:
        self.frames: list[Gaussians] = []
        self._written: _Spilled | None = None

    def __reduce__(self) -> tuple[object, ...]:
        if self._written is None:
            written = _Spilled()
            for number, frame in enumerate(self.frames):
                written.add(number, frame)
            self._written = written
        return self._written.__reduce__()

    def add(self, _number: int, frame: Gaussians) -> None:
        self.frames.append(frame)

    def read(self, _path: Path, number: int) -> Gaussians:
        return self.frames[number]
