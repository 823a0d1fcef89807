"""Two files of Gaussians that move by themselves, turn, appear and fade. N Gaussians.

At the normalised time t of [0, 1], with d = t - centre, the mean is mean + motion_1 d + ... + motion_P d^P, the
quaternion is quaternion + turn d, and alpha is alpha exp(-(d / width)^2). Sizes and colours stay. Frame i of F that are
baked is at t = i / F.

Spacetime Gaussians, the lite model (Li et al., CVPR 2024, equations 5 to 8) have P = 3 and plain RGB without SH. Their
.ply has INRIA's properties with motion, turns and temporal widths, and is told from INRIA's by trbf_center. f_dc_0 to 2
are plain RGB here, motion_0 to 2 the first power of time, and trbf_scale is a logarithm. The full model has further
features, whose colours only its network knows: it is refused.

splaTV's .splatv, 64 bytes a row, is read from the format's description by splaTV's shader: the magic 0x674b and the
length of a JSON header, both 32 bits little-endian; the header, a list whose chunk of type "splat" has the size of a
texture of 16 bytes a texel; then rows. Means are float32, colour and alpha bytes, all else float16; sizes and temporal
widths are stored as they are, without logarithm.
"""

from __future__ import annotations

import functools
import json
import struct
from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError
from airgs_codec.scene.beside import DEFAULT_FPS
from airgs_codec.scene.files import expecting, reading
from airgs_codec.scene.formats.form import Bake, Clip, ClipFormat, FrameHeader, count_frames
from airgs_codec.scene.formats.ply_elements import Header, read_columns, read_header
from airgs_codec.scene.gaussians import SH_C0, Floats, Gaussians, logits_of, logs_of, sigmoid

DEFAULT_SECONDS = Fraction(50, 30)  # no file states it; the models of the paper are trained on 50 frames of 30 fps

_SIGN = "trbf_center"
_GROUPS = (
    ("x", "y", "z"),
    tuple(f"motion_{i}" for i in range(9)),
    tuple(f"rot_{i}" for i in range(4)),
    tuple(f"omega_{i}" for i in range(4)),
    tuple(f"scale_{i}" for i in range(3)),
    ("opacity",),
    tuple(f"f_dc_{i}" for i in range(3)),
    (_SIGN,),
    ("trbf_scale",),
)
_NETWORK = ("f_t_0", "f_dc_3")

_MAGIC = 0x674B
_HEAD = struct.Struct("<II")  # magic, length of the JSON
_TEXEL = 16  # bytes
ROW = np.dtype(
    [
        ("mean", "<f4", 3),
        ("quaternion", "<f2", 4),
        ("scale", "<f2", 3),
        ("unused_1", "<f2"),
        ("rgba", "u1", 4),
        ("motion", "<f2", (3, 3)),
        ("unused_2", "<f2"),
        ("turn", "<f2", 4),
        ("centre", "<f2"),
        ("width", "<f2"),
    ]
)


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
        """The frame at normalised time t. Rows keep their order; what is not finite stays so."""
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


def _open(load: Load, name: str, path: Path, bake: Bake) -> Clip:
    """A model baked to frames, frame i of F at t = i / F. Raises SceneError."""
    fps, seconds = bake.fps or DEFAULT_FPS, bake.seconds if bake.seconds is not None else DEFAULT_SECONDS
    frames = count_frames(path, fps, seconds)
    rest = _model(load, path).rest
    note = f"{name}, {len(rest)} Gaussians baked to {frames} frames at {float(fps):g} a second: {float(seconds):.4g} s"
    note += " by default, no length is stated" if bake.seconds is None else ""
    header = FrameHeader(len(rest), rest.sh_degree)
    return Clip((header,) * frames, fps, functools.partial(_frame, load, frames), note)


def _frame(load: Load, frames: int, path: Path, frame: int) -> Gaussians:
    return _model(load, path).at(frame / frames)


def _model(load: Load, path: Path) -> Moving:
    with reading(path):
        return _cached(load, path, path.stat().st_mtime_ns)


@functools.lru_cache(maxsize=2)
def _cached(load: Load, path: Path, _written: int) -> Moving:
    return load(path)


def _without_sh(means: Floats, quaternions: Floats, log_scales: Floats, rgb: Floats) -> Gaussians:
    """Gaussians of one colour from all sides, RGB of [0, 1]."""
    dc = ((rgb - np.float32(0.5)) / np.float32(SH_C0)).astype(np.float32)
    nothing = np.zeros(len(means), np.float32)
    return Gaussians(means, quaternions, log_scales, nothing, dc, np.zeros((len(means), 0, 3), np.float32))


def is_spacetime_ply(header: Header) -> bool:
    """Return whether a .ply is of this format."""
    vertex = header.element("vertex")
    return vertex is not None and any(p.name == _SIGN for p in vertex.properties)


def read_spacetime_ply(path: Path) -> Moving:
    """The model of a file. Raises SceneError."""
    header = read_header(path)
    vertex = header.element("vertex")
    names = {p.name for p in vertex.properties} if vertex else set()
    if missing := [name for group in _GROUPS for name in group if name not in names]:
        raise SceneError(f"{path}: expected the properties of Spacetime Gaussians, missing {', '.join(missing)}")
    if not names.isdisjoint(_NETWORK):
        raise SceneError(f"{path}: expected Spacetime Gaussians of the lite model, got colours of a network")
    if vertex is None or not vertex.count:
        raise SceneError(f"{path}: expected at least one Gaussian, got none")
    columns = read_columns(path, header, vertex, _GROUPS)
    means, motion, quaternions, turns, log_scales, logits, rgb, centres, log_widths = columns
    with np.errstate(over="ignore"):
        widths = np.exp(log_widths[:, 0])
    rest = _without_sh(means, quaternions, log_scales, rgb)
    return Moving(rest, motion.reshape(-1, 3, 3), sigmoid(logits[:, 0]), centres[:, 0], widths, turns)


def read_splatv(path: Path) -> Moving:
    """The model of a file; rows of zeros at its end, which pad the texture, are left out. Raises SceneError."""
    rows = _rows(path, path.read_bytes())
    rgba = rows["rgba"].astype(np.float32) / np.float32(255)
    means, quaternions = np.ascontiguousarray(rows["mean"]), rows["quaternion"].astype(np.float32)
    rest = _without_sh(means, quaternions, logs_of(rows["scale"].astype(np.float32)), rgba[:, :3])
    motion, turns, centres, widths = (rows[n].astype(np.float32) for n in ("motion", "turn", "centre", "width"))
    return Moving(rest, motion, rgba[:, 3], centres, widths, turns)


def _rows(path: Path, data: bytes) -> np.ndarray:
    """The rows, (N,) of ROW, as many as the texture in the header is high. Raises SceneError."""
    if len(data) < _HEAD.size or _HEAD.unpack_from(data)[0] != _MAGIC:
        raise SceneError(f"{path}: expected a .splatv file, got {data[:8]!r}")
    start = _HEAD.size + _HEAD.unpack_from(data)[1]
    width, height = _texture(path, data[_HEAD.size : start])
    count, rest = divmod(len(data) - start, ROW.itemsize)
    row_texels = ROW.itemsize // _TEXEL
    if count <= 0 or rest or -(-count * row_texels // width) != height:
        expected = f"rows of {ROW.itemsize} bytes that fill a texture of {width} x {height}"
        raise SceneError(f"{path}: expected {expected}, got {len(data) - start} bytes, a broken or truncated file")
    rows = np.frombuffer(data, ROW, count, start)
    used = np.flatnonzero(np.frombuffer(data, np.uint8, offset=start).reshape(count, -1).any(axis=1))
    if not len(used):
        raise SceneError(f"{path}: expected Gaussians, got rows of zeros")
    return rows[: used[-1] + 1]


def _texture(path: Path, text: bytes) -> tuple[int, int]:
    with expecting(path, "a .splatv header with one chunk of type splat"):
        [chunk] = [chunk for chunk in json.loads(text) if chunk["type"] == "splat"]
        return _positive(chunk["texwidth"]), _positive(chunk["texheight"])


def _positive(value: Any) -> int:
    if not isinstance(value, int) or value < 1:
        raise ValueError(f"expected a number of at least 1, got {value!r}"[:80])
    return value


SPACETIME_PLY = ClipFormat(
    name="Spacetime Gaussians .ply",
    suffixes=(".ply",),
    fits=is_spacetime_ply,
    open=functools.partial(_open, read_spacetime_ply, "Spacetime Gaussians .ply"),
)
SPLATV = ClipFormat(name=".splatv", suffixes=(".splatv",), open=functools.partial(_open, read_splatv, ".splatv"))
