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
from typing import Any

import numpy as np

from airgs_codec.errors import SceneError
from airgs_codec.scene.files import require
from airgs_codec.scene.formats.form import SIZES, Axes, FrameFormat, FrameHeader, Holds, check_count
from airgs_codec.scene.formats.ply import read_header, read_ply, write_ply
from airgs_codec.scene.formats.sandbox import run_limited
from airgs_codec.scene.gaussians import SATURATED_LOGIT, SH_C0, SH_REST, Gaussians, logits_of, logs_of, morton_order

LIBRARY = "gaussforge"
_COPIES = 16  # of a frame in float32, as input, in the library, as .ply


def expect_library(path: Path, form: str, library: str) -> None:
    """Raise SceneError, which says how to install it, when a library that a format needs is not installed."""
    if importlib.util.find_spec(library) is None:
        wanted = library if library in (LIBRARY, _WRITER) else "'airgs-codec[formats]'"
        raise SceneError(f"{path}: {form} files need {library}: pip install {wanted}")


def read_with_library(path: Path, form: str, header: FrameHeader) -> Gaussians:
    """Return the Gaussians of a file whose header has been read; `form` is gaussforge's name of the format.

    Raises SceneError without the library, for what it cannot read, and for others than the header promises.
    """
    expect_library(path, form, LIBRARY)
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "frame.ply"
        reason = run_limited(LIBRARY, [form, "ply", str(target)], _COPIES * header.bytes, path.read_bytes())
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
    """Write one frame of unit quaternions by gaussforge, whose name of the format is `form`. Raises SceneError."""
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
    """Return the count, from the length. Raises SceneError when it is not of whole rows."""
    size = path.stat().st_size
    require(size and not size % ROW_BYTES, path, f"expected .splat rows of {ROW_BYTES} bytes, got a file of {size}")
    return FrameHeader(size // ROW_BYTES, 0)


def read_splat(path: Path) -> Gaussians:
    count = read_splat_header(path).count
    rows = np.fromfile(path, _ROW)
    means, turns, rgba = np.ascontiguousarray(rows["means"]), rows["rotation"].astype(np.float32), rows["rgba"] / 255
    turns, dc = (turns - np.float32(128)) / np.float32(128), ((rgba[:, :3] - 0.5) / SH_C0).astype(np.float32)
    rest = np.zeros((count, 0, 3), np.float32)
    return Gaussians(means, turns, logs_of(rows["scales"]), logits_of(rgba[:, 3]), dc, rest)


def write_splat(path: Path, gaussians: Gaussians) -> None:
    """Write one frame of unit quaternions and colours within SPLAT's ranges, its rows in their order."""
    rows = np.empty(len(gaussians), _ROW)
    rows["means"] = gaussians.means
    rows["scales"] = np.exp(gaussians.log_scales)
    rows["rgba"][:, :3] = np.rint((gaussians.sh_dc * SH_C0 + 0.5) * 255)
    rows["rgba"][:, 3] = np.rint(gaussians.opacities() * 255)
    rows["rotation"] = np.clip(np.rint(gaussians.quaternions * 128 + 128), 0, 255)
    rows.tofile(path)


SPLAT = FrameFormat(
    ".splat", "splat", (".splat",), read_splat_header, read_splat, write_splat,
    Holds(0, "colours, opacities and rotations to 8 bits", ranges=(SIZES, ("sh_dc", -0.5 / SH_C0, 0.5 / SH_C0))),
)  # fmt: skip

_GZIP = b"\x1f\x8b"
_HEAD = struct.Struct("<4sIIBB")  # magic, version, count, SH degree, fractional bits
_MAX_BITS = 24  # of a position
_USUAL_BITS = 12  # of a fraction of a position, which Niantic's writer takes
_LARGEST = (1 << 23) - 1  # of a position in steps
_WRITER = "gsply"


def read_spz_header(path: Path) -> FrameHeader:
    """Return count and SH degree. Raises SceneError for what is no .spz of version 2 to 4."""
    with path.open("rb") as file:
        head = start = file.read(1 << 12)
    packed = start[:2] == _GZIP
    try:
        head = zlib.decompressobj(zlib.MAX_WBITS | 16).decompress(start, _HEAD.size) if packed else start[: _HEAD.size]
    except zlib.error as error:
        raise SceneError(f"{path}: expected an .spz file, got broken gzip: {error}") from error
    require(len(head) == _HEAD.size and head[:4] == b"NGSP", path, f"expected an .spz file, got {start[:8]!r}")
    _, version, count, degree, bits = _HEAD.unpack(head)
    require(version in ((2, 3) if packed else (4,)), path, f"expected .spz of version 2 to 4, got {version}")
    if degree >= len(SH_REST) or not 1 <= bits <= _MAX_BITS:
        raise SceneError(f"{path}: expected SH degree 0 to 3 and 1 to {_MAX_BITS} bits, got {degree} and {bits}")
    return check_count(path, FrameHeader(count, degree))


def read_spz(path: Path) -> Gaussians:
    return read_with_library(path, "spz", read_spz_header(path))


def _for_gsply(path: Path, form: str, g: Gaussians) -> Any:
    """Return Gaussians as gsply has them. Raises SceneError when the library is not installed."""
    expect_library(path, form, _WRITER)
    import gsply

    sh = g.sh_rest if g.sh_degree else None
    return gsply.GSData.from_arrays(g.means, g.log_scales, g.quaternions, g.opacity_logits, g.sh_dc, sh, format="ply")


def write_spz(path: Path, gaussians: Gaussians) -> None:
    """Write one frame within SPZ's ranges as version 3, its rows in their order, SH in all 8 bits.

    gsply writes it: gaussforge leaves 4 or 5 bits of SH. A step of a position is 2^-12, or as large as it must be for
    the farthest Gaussian. Raises SceneError without the library and for a position too far away.
    """
    data, far = _for_gsply(path, ".spz", gaussians), float(np.abs(gaussians.means).max(initial=0))
    bits = min(_USUAL_BITS, int(np.floor(np.log2(_LARGEST / max(far, 1)))))
    require(bits >= 1, path, f"expected positions within {_LARGEST // 2} for .spz, got {far:g}")
    from gsply import write_spz as write

    write(path, data, version=3, fractional_bits=bits)


_SPZ_HOLDS = Holds(
    rounding="positions to 24 bits, rotations to 10, all else to 8",
    ranges=(("log_scales", -10, -10 + 255 / 16), ("sh_dc", -0.5 / 0.15, 0.5 / 0.15), ("sh_rest", -1, 127 / 128)),
)
SPZ = FrameFormat(".spz", "spz", (".spz",), read_spz_header, read_spz, write_spz, _SPZ_HOLDS, axes=Axes((0, 1, 0)))

_CHUNK = 256  # rows
_PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")


def read_compressed_header(path: Path) -> FrameHeader:
    """Return count and SH degree. Raises SceneError for a header or a length that is not this format's."""
    header = read_header(path)
    vertex, chunk, sh = (header.elements.get(name) for name in ("vertex", "chunk", "sh"))
    if vertex is None or vertex.properties != dict.fromkeys(_PACKED, np.dtype("<u4")):
        raise SceneError(f"{path}: expected a binary compressed .ply with four packed words a row")
    chunks = -(-vertex.count // _CHUNK)
    if chunk is None or chunk.count != chunks:
        raise SceneError(f"{path}: expected {chunks} chunks with bounds, got {chunk.count if chunk else 'none'}")
    coefficients = len(sh.properties) if sh else 0
    if coefficients % 3 or coefficients // 3 not in SH_REST:
        raise SceneError(f"{path}: expected 0, 9, 24 or 45 SH properties, got {coefficients}")
    if (size := path.stat().st_size) < (expected := header.end_of([*header.elements][-1])):
        raise SceneError(f"{path}: expected {expected} bytes, got a truncated file of {size}")
    return FrameHeader(vertex.count, SH_REST.index(coefficients // 3))


def read_compressed(path: Path) -> Gaussians:
    return read_with_library(path, "compressed.ply", read_compressed_header(path))


def write_compressed(path: Path, gaussians: Gaussians) -> None:
    """Write one frame of unit quaternions, within COMPRESSED's ranges, in Morton order: neighbours share bounds."""
    data = _for_gsply(path, "compressed .ply", gaussians.take(morton_order(gaussians.means)))
    from gsply import compress_to_bytes

    path.write_bytes(compress_to_bytes(data))


COMPRESSED = FrameFormat(
    "compressed .ply", "compressed.ply", (".ply",), read_compressed_header, read_compressed, write_compressed,
    Holds(
        rounding="positions and sizes to 10 or 11 bits of the range of 256 neighbours, rotations to 10, all else to 8",
        keeps_rows=False,
        ranges=(("log_scales", -20, 20), ("sh_rest", -4, 4)),
    ),
    signs=_PACKED,
)  # fmt: skip
