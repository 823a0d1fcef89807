"""Clips, which hold many frames: arrays of a program, models of Gaussians that move, and what libraries decode.

.4dgs of Avala is decoded by fourdgs, .splat4d of splats4D by its command, each in a process of its own. Two files hold
Gaussians that move by themselves, turn, appear and fade. At the normalised time t of [0, 1], with d = t - centre, the
mean is mean + motion_1 d + ... + motion_P d^P, the quaternion is quaternion + turn d, and alpha is
alpha exp(-(d / width)^2). Sizes and colours stay. Frame i of F that are baked is at t = i / F.

Spacetime Gaussians, the lite model (Li et al., CVPR 2024, equations 5 to 8) have P = 3 and plain RGB without SH. Their
.ply has INRIA's properties with motion, turns and temporal widths, and trbf_center tells it from INRIA's. f_dc_0 to 2
are plain RGB here, motion_0 to 2 the first power of time, and trbf_scale is a logarithm. The full model has further
features, whose colours only its network knows: it is refused.

splaTV's .splatv, 64 bytes a row, is read from the format's description by splaTV's shader: the magic 0x674b and the
length of a JSON header, both 32 bits little-endian; the header, a list whose chunk of type "splat" has the size of a
texture of 16 bytes a texel; then rows. Means are float32, colour and alpha bytes, all else float16; sizes and temporal
widths are stored as they are, without logarithm. T frames of N Gaussians.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
import tempfile
import weakref
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec._arguments import described
from airgs_codec.errors import SceneError
from airgs_codec.scene.beside import DEFAULT_FPS, MAX_FPS, exact_number, frame_rate
from airgs_codec.scene.files import Cursor, expecting, open_splatv, require
from airgs_codec.scene.formats.form import (
    MOST_FRAMES,
    Bake,
    Clip,
    ClipFormat,
    FrameHeader,
    check_count,
    count_frames,
)
from airgs_codec.scene.formats.packed import ROW_BYTES, expect_library, read_splat
from airgs_codec.scene.formats.ply import read_columns, read_ply, read_vertex, write_ply
from airgs_codec.scene.formats.sandbox import SECONDS, run_limited
from airgs_codec.scene.gaussians import SH_C0, Floats, Gaussians, as_floats, logits_of, logs_of, sigmoid

Frame = Gaussians | Mapping[str, Any]
NAMES = tuple(Gaussians.__slots__)
GSPLAT = dict(zip(("means", "quats", "scales", "opacities", "sh0", "shN"), NAMES, strict=True))  # as gsplat trains them


def clip_of(frames: Mapping[str, Any] | Iterable[Frame], fps: Fraction | float) -> Clip:
    """Return a clip of checked frames; those of an iterator are written to a temporary folder that lasts as long as it.

    Raises SceneError, which names the frame and the attribute.
    """
    rate, headers = frame_rate("fps", fps), list[FrameHeader]()
    if not isinstance(frames, Iterable):
        raise SceneError(f"frames: expected frames or a mapping of arrays with a time axis, got {described(frames)}")
    stored = _Stored([] if isinstance(frames, Sequence | Mapping) else None)
    for number, frame in enumerate(_by_time(frames) if isinstance(frames, Mapping) else frames):
        g = _checked(frame, f"frame {number}")
        headers.append(FrameHeader(len(g), g.sh_degree))
        if g.sh_degree != headers[0].sh_degree:
            expected = f"expected SH degree {headers[0].sh_degree} as in frame 0"
            raise SceneError(f"frame {number}: sh_rest: {expected}, got {g.sh_degree}")
        stored.add(number, g)
    require(headers, "frames", "expected at least one, got none")
    return Clip(tuple(headers), rate, stored.read, "frames from arrays")


def _by_time(arrays: Mapping[str, Any]) -> list[dict[str, NDArray[np.float32]]]:
    """Return the frames of arrays whose first axis is time."""
    columns = _ours({name: as_floats(name, value, name == NAMES[0]) for name, value in arrays.items()}, "frames")
    shape = columns["means"].shape if "means" in columns else ()
    require(len(shape) == 3, "means", f"expected an array of shape (T, N, 3), got {shape or 'none'}")
    for name, column in columns.items():
        if column.shape[:1] != shape[:1]:
            raise SceneError(f"{name}: expected {shape[0]} frames as of means, got the shape {column.shape}")
    return [{name: column[t] for name, column in columns.items()} for t in range(shape[0])]


def as_gaussians(value: Frame) -> Gaussians:
    """Return the argument `gaussians` of a function as Gaussians. Raises SceneError."""
    return value if isinstance(value, Gaussians) else _checked(value, "gaussians")


def _ours(columns: dict[str, NDArray[np.float32]], where: str) -> dict[str, NDArray[np.float32]]:
    """Rename gsplat's arrays. Raises SceneError for sizes and opacities as its rasteriser takes them."""
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
        frame = frame.columns()
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
    require(len(g), where, "expected at least one Gaussian, got none")
    for name, column in g.columns().items():
        with np.errstate(over="ignore"):
            narrow = column.astype(np.float32, copy=False)  # what becomes infinite is refused
        finite = np.isfinite(narrow) | (name == "log_scales") & np.isneginf(narrow)
        if not finite.all():
            place = tuple(np.argwhere(~finite)[0].tolist())
            raise SceneError(f"{where}: {name}: expected finite numbers, got {columns[name][place]} in row {place[0]}")
    return g


class _Stored:
    """Frames in a list or a temporary folder that lasts as long; other processes read them in a folder."""

    def __init__(self, frames: list[Gaussians] | None, folder: Path | None = None) -> None:
        self._frames, self._folder = frames, folder

    def __reduce__(self) -> tuple[object, ...]:
        if self._frames is not None and self._folder is None:
            for number, frame in enumerate(self._frames):
                write_ply(self._path(number), frame)
        return _Stored, (None, self._folder)

    def add(self, number: int, frame: Gaussians) -> None:
        if self._frames is None:
            write_ply(self._path(number), frame)
        else:
            self._frames.append(frame)

    def read(self, _path: Path, number: int) -> Gaussians:
        return read_ply(self._path(number)) if self._frames is None else self._frames[number]

    def _path(self, number: int) -> Path:
        if self._folder is None:
            self._folder = Path(tempfile.mkdtemp(prefix="airgs-"))
            weakref.finalize(self, shutil.rmtree, self._folder, ignore_errors=True)
        return self._folder / f"{number:06d}.ply"


_CLIP_COPIES = 128  # of the bytes of a .4dgs in the library, at least
_SECONDS_PER_BYTE = 5e-6  # of a .4dgs: about five times what the library takes
_ROW_COPIES = 64  # of a row of .splat, in the command
_MOST_JSON = 1 << 24  # bytes


def open_4dgs(path: Path, bake: Bake) -> Clip:
    """Bake all frames of a file to a temporary folder. Raises SceneError."""
    _refuse_duration(path, bake)
    expect_library(path, ".4dgs", "fourdgs")
    data = path.read_bytes()
    with tempfile.TemporaryDirectory() as folder:
        words = [str(bake.fps or 0), str(DEFAULT_FPS), str(MOST_FRAMES), folder]
        seconds = SECONDS + _SECONDS_PER_BYTE * len(data)
        if reason := run_limited("fourdgs", words, _CLIP_COPIES * len(data), data, seconds=seconds):
            raise SceneError(f"{path}: expected .4dgs, got what fourdgs cannot read: {reason}")
        fps, model = json.loads(Path(folder, "said.json").read_text())
        try:
            clip = clip_of(map(_baked, sorted(Path(folder).glob("*.npy"))), exact_number(fps))
        except SceneError as error:
            raise SceneError(f"{path}: {error}") from error
    numbers = " to ".join(map(str, sorted({header.count for header in clip.headers})[:: max(1, len(clip.headers) - 1)]))
    return replace(clip, note=f".4dgs, {model}: {numbers} Gaussians in {len(clip.headers)} frames")


def _baked(rows: Path) -> Gaussians:
    means, quaternions, sizes, alpha, rgb, sh = np.split(np.load(rows), [3, 7, 10, 11, 14], axis=1)
    dc = (rgb - np.float32(0.5)) / np.float32(SH_C0)
    rest = sh.reshape(len(sh), 3, sh.shape[1] // 3).transpose(0, 2, 1)
    return Gaussians(means, quaternions, logs_of(sizes), logits_of(alpha[:, 0]), dc, rest)


def open_splat4d(path: Path, bake: Bake) -> Clip:
    """Return the frames of a file, each read when it is asked for. Raises SceneError.

    Its beginning: the magic SP4D, a version and the length of a JSON header, 32 bits little-endian each, and the
    header, of which `n` is the number of rows, `t` that of frames. A frame has no SH, its rows are in one order.
    """
    _refuse_duration(path, bake)
    if bake.fps is not None:
        raise SceneError(f"{path}: expected no frame rate to bake at, .splat4d has whole frames, got {bake.fps} fps")
    with expecting(path, "a .splat4d header"):
        cursor = Cursor.open(path)
        magic, version, length = cursor.take("4sII")
        if (magic, version) != (b"SP4D", 1):
            raise ValueError(f"version 1, got {magic!r} of version {version}")
        header = json.loads(cursor.piece(min(length, _MOST_JSON)))
        count, frames, fps = header["n"], header["t"], exact_number(str(header["fps"]))
        whole = isinstance(count, int) and isinstance(frames, int)
        if not whole or min(count, frames) < 1 or not 0 < fps <= MAX_FPS:
            raise ValueError(f"{count} Gaussians, {frames} frames, {fps} fps"[:120])
    frame = check_count(path, FrameHeader(count, 0))
    count_frames(path, fps, frames / fps)
    note = f".splat4d, {count} Gaussians in {frames} frames, {float(fps):g} a second"
    return Clip((frame,) * frames, fps, partial(_read_splat4d, count), note)


def _read_splat4d(count: int, path: Path, frame: int) -> Gaussians:
    places = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    if (command := shutil.which("splat4d", path=places)) is None:
        raise SceneError(f"{path}: .splat4d files need splats4d: pip install 'airgs-codec[formats]'")
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "frame.splat"
        words = ["decode", str(path.absolute()), "--frame", str(frame), "-o", str(target)]
        reason = run_limited(command, words, count * _ROW_COPIES * ROW_BYTES)
        if reason or not target.is_file():
            raise SceneError(f"{path}: expected .splat4d, got what splat4d cannot read at frame {frame}: {reason}")
        g = read_splat(target)
    require(len(g) == count, path, f"expected {count} Gaussians in frame {frame} as its header says, got {len(g)}")
    return g


def _refuse_duration(path: Path, bake: Bake) -> None:
    if bake.seconds is not None:
        raise SceneError(f"{path}: expected no duration, the file states its own, got {float(bake.seconds):g} s")


DEFAULT_SECONDS = Fraction(50, 30)  # no file states it; the models of the paper are trained on 50 frames of 30 fps
_SIGN = "trbf_center"
_GROUPS = (
    ("x", "y", "z"),
    *(tuple(f"{name}_{i}" for i in range(n)) for name, n in (("motion", 9), ("rot", 4), ("omega", 4), ("scale", 3))),
    ("opacity",),
    tuple(f"f_dc_{i}" for i in range(3)),
    (_SIGN,),
    ("trbf_scale",),
)
_NETWORK = ("f_t_0", "f_dc_3")
ROW = np.dtype([
    ("mean", "<f4", 3), ("quaternion", "<f2", 4), ("scale", "<f2", 3), ("unused_1", "<f2"), ("rgba", "u1", 4),
    ("motion", "<f2", (3, 3)), ("unused_2", "<f2"), ("turn", "<f2", 4), ("centre", "<f2"), ("width", "<f2"),
])  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Moving:
    """A model of N Gaussians, all float32."""

    rest: Gaussians  # as at d = 0, whatever its opacities
    motion: NDArray[np.float32]  # (N, P, 3) of powers 1 to P of d, then axes
    alpha: NDArray[np.float32]  # (N,) of [0, 1]
    centres: NDArray[np.float32]  # (N,) normalised time
    widths: NDArray[np.float32]  # (N,) normalised time
    turns: NDArray[np.float32] | None = None  # (N, 4) of the quaternion

    def at(self, t: float) -> Gaussians:
        """Return the frame at normalised time t. Rows keep their order; what is not finite stays so."""
        d = (np.float32(t) - self.centres)[:, None]
        shift = np.zeros_like(self.rest.means)
        with np.errstate(all="ignore"):
            for power in range(self.motion.shape[1])[::-1]:
                shift = d * (self.motion[:, power] + shift)
            alpha = self.alpha * np.exp(-np.square(d[:, 0] / self.widths))
            quaternions = self.rest.quaternions if self.turns is None else self.rest.quaternions + d * self.turns
            means = self.rest.means + shift
        return replace(self.rest, means=means, quaternions=quaternions, opacity_logits=logits_of(alpha))


Load = Callable[[Path], Moving]  # reads a file; raises SceneError, OSError


def _open_moving(load: Load, name: str, path: Path, bake: Bake) -> Clip:
    fps, seconds = bake.fps or DEFAULT_FPS, DEFAULT_SECONDS if bake.seconds is None else bake.seconds
    frames, count = count_frames(path, fps, seconds), len(_model(load, path, path.stat().st_mtime_ns).rest)
    note = f"{name}, {count} Gaussians baked to {frames} frames at {float(fps):g} a second: {float(seconds):.4g} s"
    note += " by default, no length is stated" if bake.seconds is None else ""
    return Clip((FrameHeader(count, 0),) * frames, fps, partial(_frame, load, frames), note)


def _frame(load: Load, frames: int, path: Path, frame: int) -> Gaussians:
    with expecting(path, "a file of moving Gaussians"):
        return _model(load, path, path.stat().st_mtime_ns).at(frame / frames)


@lru_cache(maxsize=2)
def _model(load: Load, path: Path, _written: int) -> Moving:
    return load(path)


def _without_sh(means: Floats, quaternions: Floats, log_scales: Floats, rgb: Floats) -> Gaussians:
    dc, nothing = ((rgb - np.float32(0.5)) / np.float32(SH_C0)).astype(np.float32), np.zeros(len(means), np.float32)
    return Gaussians(means, quaternions, log_scales, nothing, dc, np.zeros((len(means), 0, 3), np.float32))


def read_spacetime_ply(path: Path) -> Moving:
    header, vertex = read_vertex(path, "element vertex")
    names = {*vertex.properties}
    if missing := [name for group in _GROUPS for name in group if name not in names]:
        raise SceneError(f"{path}: expected the properties of Spacetime Gaussians, missing {', '.join(missing)}")
    if not names.isdisjoint(_NETWORK):
        raise SceneError(f"{path}: expected Spacetime Gaussians of the lite model, got colours of a network")
    require(vertex.count, path, "expected at least one Gaussian, got none")
    columns = read_columns(path, header, vertex, _GROUPS)
    means, motion, quaternions, turns, log_scales, logits, rgb, centres, log_widths = columns
    rest = _without_sh(means, quaternions, log_scales, rgb)
    with np.errstate(over="ignore"):
        widths = np.exp(log_widths[:, 0])
    return Moving(rest, motion.reshape(-1, 3, 3), sigmoid(logits[:, 0]), centres[:, 0], widths, turns)


def read_splatv(path: Path) -> Moving:
    """Read the model of a file; rows of zeros at its end, which pad the texture, are left out. Raises SceneError."""
    with expecting(path, "a .splatv file, a header with one chunk of type splat and rows that fill its texture"):
        cursor, chunks = open_splatv(path)
        [chunk] = [chunk for chunk in chunks if chunk["type"] == "splat"]
        size = len(cursor.data) - cursor.at
        count, rest = divmod(size, ROW.itemsize)
        if rest or -(-count * ROW.itemsize // (16 * chunk["texwidth"])) != chunk["texheight"]:  # 16 bytes a texel
            texture = f"{chunk['texwidth']} x {chunk['texheight']}"
            raise ValueError(f"{size} bytes for a texture of {texture}, a broken or truncated file")
        rows = np.frombuffer(cursor.data, ROW, count, cursor.at)
        used = np.flatnonzero(rows.view(np.uint8).reshape(count, -1).any(axis=1))
        if not len(used):
            raise ValueError("got rows of zeros")
        rows = rows[: used[-1] + 1]
    rgba = rows["rgba"].astype(np.float32) / np.float32(255)
    means, quaternions = np.ascontiguousarray(rows["mean"]), rows["quaternion"].astype(np.float32)
    first = _without_sh(means, quaternions, logs_of(rows["scale"].astype(np.float32)), rgba[:, :3])
    motion, turns, centres, widths = (rows[n].astype(np.float32) for n in ("motion", "turn", "centre", "width"))
    return Moving(first, motion, rgba[:, 3], centres, widths, turns)


FOUR_DGS = ClipFormat(".4dgs", (".4dgs",), open_4dgs)
SPLAT4D = ClipFormat(".splat4d", (".splat4d",), open_splat4d)
_SPACETIME = "Spacetime Gaussians .ply"
SPACETIME_PLY = ClipFormat(_SPACETIME, (".ply",), partial(_open_moving, read_spacetime_ply, _SPACETIME), (_SIGN,))
SPLATV = ClipFormat(".splatv", (".splatv",), partial(_open_moving, read_splatv, ".splatv"))
