"""splaTV's .splatv: Spacetime Gaussians, 64 bytes a row; read from the format's description by splaTV's shader.

The magic 0x674b and the length of a JSON header, both 32 bits little-endian; the header, a list whose chunk of type
"splat" has the size of a texture of 16 bytes a texel; then rows. Means are float32, colour and alpha bytes, all else
float16; sizes and temporal widths are stored as they are, without logarithm.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from airgs_codec.errors import SceneError
from airgs_codec.scene.formats.clip import Bake, Clip
from airgs_codec.scene.formats.linear import logs_of
from airgs_codec.scene.formats.spacetime import Spacetime, open_spacetime

_MAGIC = 0x674B
_HEADER = struct.Struct("<II")  # magic, length of the JSON
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


def open_splatv(path: Path, bake: Bake) -> Clip:
    """The frames of a file. Raises SceneError."""
    return open_spacetime(path, read_splatv, ".splatv", bake)


def read_splatv(path: Path) -> Spacetime:
    """The model of a file; rows of zeros at its end, which pad the texture, are left out. Raises SceneError."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise SceneError(f"{path}: cannot read: {error.strerror}") from error
    rows = _rows(path, data)
    rgba = rows["rgba"].astype(np.float32) / np.float32(255)
    return Spacetime(
        np.ascontiguousarray(rows["mean"]),
        rows["motion"].astype(np.float32),
        rows["quaternion"].astype(np.float32),
        rows["turn"].astype(np.float32),
        logs_of(rows["scale"].astype(np.float32)),
        rgba[:, 3],
        rgba[:, :3],
        rows["centre"].astype(np.float32),
        rows["width"].astype(np.float32),
    )


def _rows(path: Path, data: bytes) -> np.ndarray:
    """The rows, (N,) of ROW, as many as the texture in the header is high. Raises SceneError."""
    if len(data) < _HEADER.size or _HEADER.unpack_from(data)[0] != _MAGIC:
        raise SceneError(f"{path}: expected a .splatv file, got {data[:8]!r}")
    start = _HEADER.size + _HEADER.unpack_from(data)[1]
    width, height = _texture(path, data[_HEADER.size : start])
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
    """Texels across and down, from the JSON."""
    try:
        [chunk] = [chunk for chunk in json.loads(text) if chunk["type"] == "splat"]
        return _positive(chunk["texwidth"]), _positive(chunk["texheight"])
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        reason = f"{type(error).__name__} {error}"[:120]
        raise SceneError(f"{path}: expected a .splatv header with one chunk of type splat: {reason}") from error


def _positive(value: Any) -> int:
    if not isinstance(value, int) or value < 1:
        raise ValueError(f"expected a number of at least 1, got {value!r}"[:80])
    return value
