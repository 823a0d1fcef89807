"""Niantic's .spz: versions 2 and 3, one gzip stream, and 4, zstd streams behind a table; SH 0 to 3."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np

from airgs_codec.errors import SceneError
from airgs_codec.scene.formats.form import Axes, FrameFormat, FrameHeader, Holds, check_count
from airgs_codec.scene.formats.library import expect_library, read_with_library
from airgs_codec.scene.gaussians import SH_REST, Gaussians

_MAGIC = b"NGSP"
_GZIP = b"\x1f\x8b"
_HEADER = struct.Struct("<4sIIBBBB")  # magic, version, count, SH degree, fractional bits, flags, streams from version 4
_TABLE = struct.Struct("<QQ")  # of a stream: bytes as it is stored, and as it unpacks
_MAX_BITS = 24  # of a position
_EXTENSIONS = 1 << 20  # bytes after the rows that are let pass
_USUAL_BITS = 12  # of a fraction of a position, which Niantic's writer takes
_LARGEST = (1 << 23) - 1  # of a position in steps
_WRITER = "gsply"


def read_spz_header(path: Path) -> FrameHeader:
    """Count and SH degree, from the first bytes. Raises SceneError."""
    with path.open("rb") as file:
        return _header(path, file.read(1 << 12))[0]


def _header(path: Path, data: bytes) -> tuple[FrameHeader, int]:
    """The header of a file of which at least the beginning is there, and the version."""
    head = data[: _HEADER.size]
    if data[:2] == _GZIP:
        head = _unpack(path, data, _HEADER.size)
    if len(head) < _HEADER.size or head[:4] != _MAGIC:
        raise SceneError(f"{path}: expected an .spz file, got {data[:8]!r}")
    _, version, count, degree, bits, _, _ = _HEADER.unpack(head)
    if version not in ((2, 3) if data[:2] == _GZIP else (4,)):
        raise SceneError(f"{path}: expected .spz of version 2 to 4, got {version}")
    if degree >= len(SH_REST) or not 1 <= bits <= _MAX_BITS:
        raise SceneError(f"{path}: expected SH degree 0 to 3 and 1 to {_MAX_BITS} bits, got {degree} and {bits}")
    return check_count(path, FrameHeader(count, degree)), version


def read_spz(path: Path) -> Gaussians:
    """One frame. Raises SceneError; nothing is unpacked past what its header promises."""
    data = path.read_bytes()
    header, version = _header(path, data)
    rotation = 4 if version >= 3 else 3
    expected = header.count * (9 + 1 + 3 + 3 + rotation + 3 * SH_REST[header.sh_degree])
    size = _table_size(path, data) if version >= 4 else len(_unpack(path, data, expected + _EXTENSIONS)) - _HEADER.size
    if not expected <= size < expected + _EXTENSIONS - _HEADER.size:
        raise SceneError(f"{path}: expected {expected} bytes of {header.count} Gaussians, got {size}")
    return read_with_library(path, "spz", data, header)


def write_spz(path: Path, gaussians: Gaussians) -> None:
    """Write one frame within SPZ's ranges as version 3, its rows in their order, SH in all 8 bits.

    gsply writes it: gaussforge keeps 4 or 5 bits of SH. A step of a position is 2^-12, or as large as it must be for
    the farthest Gaussian. Raises SceneError when the library is not there or a position is too far away.
    """
    expect_library(path, ".spz", _WRITER)
    from gsply import GSData, write_spz

    far = float(np.abs(gaussians.means).max(initial=0))
    bits = min(_USUAL_BITS, int(np.floor(np.log2(_LARGEST / max(far, 1)))))
    if bits < 1:
        raise SceneError(f"{path}: expected positions within {_LARGEST // 2} for .spz, got {far:g}")
    g = gaussians
    sh = g.sh_rest if g.sh_degree else None
    data = GSData.from_arrays(g.means, g.log_scales, g.quaternions, g.opacity_logits, g.sh_dc, sh, format="ply")
    write_spz(path, data, version=3, fractional_bits=bits)


def _unpack(path: Path, data: bytes, most: int) -> bytes:
    try:
        return zlib.decompressobj(zlib.MAX_WBITS | 16).decompress(data, most)
    except zlib.error as error:
        raise SceneError(f"{path}: expected an .spz file, got broken gzip: {error}") from error


def _table_size(path: Path, data: bytes) -> int:
    """Return what the streams of version 4 unpack to, as their table says."""
    streams, start = data[15], int.from_bytes(data[16:20], "little")
    if len(data) < start + streams * _TABLE.size:
        raise SceneError(f"{path}: expected the table of {streams} streams, got a truncated file")
    rows = [_TABLE.unpack_from(data, start + i * _TABLE.size) for i in range(streams)]
    if (end := start + streams * _TABLE.size + sum(stored for stored, _ in rows)) > len(data):
        raise SceneError(f"{path}: expected {end} bytes, got a truncated file of {len(data)}")
    return sum(size for _, size in rows)


SPZ = FrameFormat(
    name=".spz",
    key="spz",
    suffixes=(".spz",),
    read_header=read_spz_header,
    read=read_spz,
    write=write_spz,
    holds=Holds(
        rounding="positions to 24 bits, rotations to 10, all else to 8",
        ranges=(("log_scales", -10, -10 + 255 / 16), ("sh_dc", -0.5 / 0.15, 0.5 / 0.15), ("sh_rest", -1, 127 / 128)),
    ),
    writer=_WRITER,
    axes=Axes((0, 1, 0)),
)
