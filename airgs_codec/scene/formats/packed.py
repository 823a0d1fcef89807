"""Splat files of packed rows: .splat, Niantic's .spz and PlayCanvas' compressed .ply; what gaussforge does for them.

.splat of antimatter15 has no header and 32 bytes a row: position, size, RGBA and rotation, no SH. .spz of versions 2
and 3 is one gzip stream, of version 4 zstd streams behind a table. A compressed .ply has chunks of 256 rows with bounds
and four words a row. The last two have SH 0 to 3 and are read by gaussforge, in a process of its own. N rows.
"""

from __future__ import annotations

import importlib.util
import struct
import tempfile
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError
from airgs_codec.scene.formats.form import SIZES, Axes, FrameFormat, FrameHeader, Holds, check_count
from airgs_codec.scene.formats.ply import read_header, read_ply, write_ply
from airgs_codec.scene.formats.sandbox import run_limited
from airgs_codec.scene.gaussians import SATURATED_LOGIT, SH_C0, SH_REST, Gaussians, logits_of, logs_of, morton_order

LIBRARY = "gaussforge"
_COPIES = 16  # of a frame in float32, as input, in the library, as .ply


def expect_library(path: Path, form: str, library: str) -> None:
    """Raise SceneError, which says how to install it, when a library that a format needs is not there."""
    if importlib.util.find_spec(library) is None:
        raise SceneError(f"{path}: {form} files need {library}: pip install 'airgs-codec[formats]'")


def read_with_library(path: Path, form: str, data: bytes, header: FrameHeader) -> Gaussians:
    """The Gaussians in the bytes of a file whose header has been read; `form` is gaussforge's name of the format.

    Raises SceneError when the library is not there, cannot read them, or finds others than the header promises.
    """
    expect_library(path, form, LIBRARY)
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "frame.ply"
        reason = run_limited(LIBRARY, [form, "ply", str(target)], _COPIES * header.bytes, data)
        try:
            found = read_ply(target)
        except SceneError:
            raise SceneError(f"{path}: expected {form}, got what gaussforge cannot read: {reason}") from None
    if len(found) != header.count or found.sh_degree < header.sh_degree:
        expected = f"expected {header.count} Gaussians of SH degree {header.sh_degree} as its header says"
        raise SceneError(f"{path}: {expected}, got {len(found)} of {found.sh_degree}")
    infinite = np.isinf(found.opacity_logits)
    logits = np.where(infinite, np.sign(found.opacity_logits) * SATURATED_LOGIT, found.opacity_logits)
    return replace(found.with_degree(header.sh_degree), opacity_logits=logits.astype(np.float32))


def write_with_library(path: Path, form: str, gaussians: Gaussians) -> None:
    """Writes one frame of unit quaternions; `form` is gaussforge's name of the format.

    Raises SceneError when the library is not there or writes nothing.
    """
    expect_library(path, form, LIBRARY)
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "frame.ply"
        write_ply(source, gaussians)
        more = _COPIES * FrameHeader(len(gaussians), gaussians.sh_degree).bytes
        reason = run_limited(LIBRARY, ["ply", form, str(path.absolute())], more, source.read_bytes(), seconds=None)
    if reason or not path.is_file():
        raise SceneError(f"{path}: gaussforge cannot write {len(gaussians)} Gaussians as {form}: {reason}")


_ROW = np.dtype([("means", "<f4", 3), ("scales", "<f4", 3), ("rgba", "u1", 4), ("rotation", "u1", 4)])
ROW_BYTES = _ROW.itemsize


def read_splat_header(path: Path) -> FrameHeader:
    """The count, from the length. Raises SceneError when it is not of whole rows."""
    size = path.stat().st_size
    if not size or size % ROW_BYTES:
        raise SceneError(f"{path}: expected .splat rows of {ROW_BYTES} bytes, got a file of {size}")
    return FrameHeader(size // ROW_BYTES, 0)


def read_splat(path: Path) -> Gaussians:
    read_splat_header(path)
    rows = np.fromfile(path, _ROW)
    return Gaussians(
        np.ascontiguousarray(rows["means"]),
        (rows["rotation"].astype(np.float32) - np.float32(128)) / np.float32(128),
        logs_of(rows["scales"]),
        logits_of(rows["rgba"][:, 3] / 255),
        ((rows["rgba"][:, :3] / 255 - 0.5) / SH_C0).astype(np.float32),
        np.zeros((len(rows), 0, 3), np.float32),
    )


def write_splat(path: Path, gaussians: Gaussians) -> None:
    """Writes one frame of unit quaternions and colours within SPLAT's ranges, its rows in their order."""
    rows = np.empty(len(gaussians), _ROW)
    rows["means"] = gaussians.means
    rows["scales"] = np.exp(gaussians.log_scales)
    rows["rgba"][:, :3] = np.rint((gaussians.sh_dc * SH_C0 + 0.5) * 255)
    rows["rgba"][:, 3] = np.rint(gaussians.opacities() * 255)
    rows["rotation"] = np.clip(np.rint(gaussians.quaternions * 128 + 128), 0, 255)
    rows.tofile(path)


_SPLAT_RANGES = (SIZES, ("sh_dc", -0.5 / SH_C0, 0.5 / SH_C0))
_SPLAT_HOLDS = Holds(0, "colours, opacities and rotations to 8 bits", ranges=_SPLAT_RANGES)
SPLAT = FrameFormat(".splat", "splat", (".splat",), read_splat_header, read_splat, write_splat, _SPLAT_HOLDS)

_GZIP = b"\x1f\x8b"
_HEAD = struct.Struct("<4sIIBBBB")  # magic, version, count, SH degree, fractional bits, flags, streams from version 4
_STREAM = struct.Struct("<QQ")  # bytes as it is stored, and as it unpacks
_MAX_BITS = 24  # of a position
_EXTENSIONS = 1 << 20  # bytes after the rows that are let pass
_USUAL_BITS = 12  # of a fraction of a position, which Niantic's writer takes
_LARGEST = (1 << 23) - 1  # of a position in steps
_SPZ_WRITER = "gsply"


def read_spz_header(path: Path) -> FrameHeader:
    with path.open("rb") as file:
        return _spz_header(path, file.read(1 << 12))[0]


def _spz_header(path: Path, data: bytes) -> tuple[FrameHeader, int]:
    head = _unpack(path, data, _HEAD.size) if data[:2] == _GZIP else data[: _HEAD.size]
    if len(head) < _HEAD.size or head[:4] != b"NGSP":
        raise SceneError(f"{path}: expected an .spz file, got {data[:8]!r}")
    _, version, count, degree, bits, _, _ = _HEAD.unpack(head)
    if version not in ((2, 3) if data[:2] == _GZIP else (4,)):
        raise SceneError(f"{path}: expected .spz of version 2 to 4, got {version}")
    if degree >= len(SH_REST) or not 1 <= bits <= _MAX_BITS:
        raise SceneError(f"{path}: expected SH degree 0 to 3 and 1 to {_MAX_BITS} bits, got {degree} and {bits}")
    return check_count(path, FrameHeader(count, degree)), version


def read_spz(path: Path) -> Gaussians:
    """Reads one frame. Raises SceneError; nothing is unpacked past what its header promises."""
    data = path.read_bytes()
    header, version = _spz_header(path, data)
    rotation = 4 if version >= 3 else 3
    expected = header.count * (9 + 1 + 3 + 3 + rotation + 3 * SH_REST[header.sh_degree])
    size = _table_size(path, data) if version >= 4 else len(_unpack(path, data, expected + _EXTENSIONS)) - _HEAD.size
    if not expected <= size < expected + _EXTENSIONS - _HEAD.size:
        raise SceneError(f"{path}: expected {expected} bytes of {header.count} Gaussians, got {size}")
    return read_with_library(path, "spz", data, header)


def _unpack(path: Path, data: bytes, most: int) -> bytes:
    try:
        return zlib.decompressobj(zlib.MAX_WBITS | 16).decompress(data, most)
    except zlib.error as error:
        raise SceneError(f"{path}: expected an .spz file, got broken gzip: {error}") from error


def _table_size(path: Path, data: bytes) -> int:
    streams, start = data[15], int.from_bytes(data[16:20], "little")
    end = start + streams * _STREAM.size
    if len(data) < end:
        raise SceneError(f"{path}: expected the table of {streams} streams, got a truncated file")
    stored, sizes = np.frombuffer(data[start:end], "<u8").reshape(-1, 2).astype(object).sum(axis=0, initial=0)
    if end + stored > len(data):
        raise SceneError(f"{path}: expected {end + stored} bytes, got a truncated file of {len(data)}")
    return int(sizes)


def write_spz(path: Path, gaussians: Gaussians) -> None:
    """Writes one frame within SPZ's ranges as version 3, its rows in their order, SH in all 8 bits.

    gsply writes it: gaussforge keeps 4 or 5 bits of SH. A step of a position is 2^-12, or as large as it must be for
    the farthest Gaussian. Raises SceneError when the library is not there or a position is too far away.
    """
    expect_library(path, ".spz", _SPZ_WRITER)
    import gsply

    far = float(np.abs(gaussians.means).max(initial=0))
    bits = min(_USUAL_BITS, int(np.floor(np.log2(_LARGEST / max(far, 1)))))
    if bits < 1:
        raise SceneError(f"{path}: expected positions within {_LARGEST // 2} for .spz, got {far:g}")
    g = gaussians
    sh = g.sh_rest if g.sh_degree else None
    data = gsply.GSData.from_arrays(g.means, g.log_scales, g.quaternions, g.opacity_logits, g.sh_dc, sh, format="ply")
    gsply.write_spz(path, data, version=3, fractional_bits=bits)


_SPZ_HOLDS = Holds(
    rounding="positions to 24 bits, rotations to 10, all else to 8",
    ranges=(("log_scales", -10, -10 + 255 / 16), ("sh_dc", -0.5 / 0.15, 0.5 / 0.15), ("sh_rest", -1, 127 / 128)),
)
_SPZ_UP = Axes((0, 1, 0))
SPZ = FrameFormat(
    ".spz", "spz", (".spz",), read_spz_header, read_spz, write_spz, _SPZ_HOLDS, writer=_SPZ_WRITER, axes=_SPZ_UP
)

_CHUNK = 256  # rows
_WORDS = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
_BOUNDS = tuple(f"{end}_{what}{axis}" for what in ("", "scale_") for end in ("min", "max") for axis in "xyz")
_COLOURS = tuple(f"{end}_{c}" for end in ("min", "max") for c in "rgb")
_SH_RANGE = 4.0


def read_compressed_header(path: Path) -> FrameHeader:
    """Count and SH degree. Raises SceneError for a header or a length that is not this format's."""
    header = read_header(path)
    vertex, chunk, sh = (header.elements.get(name) for name in ("vertex", "chunk", "sh"))
    if vertex is None or vertex.row != np.dtype([(name, "<u4") for name in _WORDS]):
        raise SceneError(f"{path}: expected a binary compressed .ply with four packed words a row")
    chunks = -(-vertex.count // _CHUNK)
    bounds = () if chunk is None or chunk.row is None else chunk.properties
    if chunk is None or chunk.count != chunks or not {*_BOUNDS} <= {*bounds}:
        raise SceneError(f"{path}: expected {chunks} chunks with bounds, got {chunk.count if chunk else 'none'}")
    coefficients = len(sh.properties) if sh else 0
    if coefficients % 3 or coefficients // 3 not in SH_REST:
        raise SceneError(f"{path}: expected 0, 9, 24 or 45 SH properties, got {coefficients}")
    if sh and (sh.count != vertex.count or sh.row is None or sh.row.itemsize != coefficients):
        raise SceneError(f"{path}: expected {vertex.count} SH rows of bytes, got {sh.count}")
    if (size := path.stat().st_size) < header.least_size:
        raise SceneError(f"{path}: expected {header.least_size} bytes, got a truncated file of {size}")
    return FrameHeader(vertex.count, SH_REST.index(coefficients // 3))


def read_compressed(path: Path) -> Gaussians:
    header = read_compressed_header(path)
    return read_with_library(path, "compressed.ply", path.read_bytes(), header)


def write_compressed(path: Path, gaussians: Gaussians) -> None:
    """Writes one frame of unit quaternions, within COMPRESSED's ranges, in Morton order.

    Neighbours share a chunk, whose bounds are as tight as that makes them. Layout: PlayCanvas' splat-transform.
    """
    g = gaussians.take(morton_order(gaussians.means))
    starts = np.arange(0, len(g), _CHUNK)
    bounds, shares = [], []
    for values in (g.means, g.log_scales, g.sh_dc * np.float32(SH_C0) + np.float32(0.5)):
        low, high = (end.reduceat(values, starts) for end in (np.minimum, np.maximum))
        span = np.where(high > low, high - low, np.float32(1))
        bounds += [low, high]
        shares.append((values - np.repeat(low, _CHUNK, 0)[: len(g)]) / np.repeat(span, _CHUNK, 0)[: len(g)])
    means, scales, colours = shares
    colours = np.concatenate([colours, g.opacities()[:, None]], 1)
    words = (
        _pack(means, 11, 10, 11),
        _pack_rotations(g.quaternions),
        _pack(scales, 11, 10, 11),
        _pack(colours, *[8] * 4),
    )
    rest = np.clip(np.floor((g.sh_rest / (2 * _SH_RANGE) + 0.5) * 256), 0, 255).astype(np.uint8)
    lines = ["ply", "format binary_little_endian 1.0", f"element chunk {len(starts)}"]
    lines += [f"property float {name}" for name in (*_BOUNDS, *_COLOURS)]
    lines += [f"element vertex {len(g)}", *(f"property uint {name}" for name in _WORDS)]
    if g.sh_degree:
        lines += [f"element sh {len(g)}", *(f"property uchar f_rest_{i}" for i in range(3 * rest.shape[1]))]
    with path.open("wb") as file:
        file.write("\n".join([*lines, "end_header", ""]).encode())
        file.write(np.concatenate(bounds, 1).astype("<f4").tobytes())
        file.write(np.stack(words, 1).astype("<u4").tobytes())
        file.write(rest.transpose(0, 2, 1).tobytes())


def _pack(values: NDArray[np.floating], *bits: int) -> NDArray[np.uint32]:
    """(N, len(bits)) values of [0, 1] -> (N,) words, the first value in the highest bits."""
    word = np.zeros(len(values), np.uint32)
    for i, b in enumerate(bits):
        top = (1 << b) - 1
        code = np.clip(np.rint(values[:, i].astype(np.float64) * top), 0, top).astype(np.uint32)
        word = word << np.uint32(b) | code
    return word


def _pack_rotations(quaternions: NDArray[np.float32]) -> NDArray[np.uint32]:
    """(N, 4) unit quaternions w, x, y, z -> (N,) words: which is largest in 2 bits, the other three in 10 each."""
    rows = np.arange(len(quaternions))
    largest = np.abs(quaternions).argmax(axis=1)
    q = quaternions * np.where(quaternions[rows, largest] < 0, -1, 1)[:, None]
    others = np.array([[j for j in range(4) if j != i] for i in range(4)])[largest]
    rest = np.take_along_axis(q, others, 1) * np.sqrt(0.5) + 0.5
    return largest.astype(np.uint32) << np.uint32(30) | _pack(rest, 10, 10, 10)


COMPRESSED = FrameFormat(
    "compressed .ply", "compressed.ply", (".ply",), read_compressed_header, read_compressed, write_compressed,
    Holds(
        rounding="positions and sizes to 10 or 11 bits of the range of 256 neighbours, rotations to 10, all else to 8",
        keeps_rows=False,
        ranges=(("log_scales", -20, 20), ("sh_rest", -_SH_RANGE, _SH_RANGE)),
    ),
    signs=_WORDS,
)  # fmt: skip
