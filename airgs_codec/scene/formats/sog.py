"""PlayCanvas' SOG: a meta.json and lossless WebP pictures, in a folder or a .sog or .zip; SH 0 to 3. N Gaussians.

A pixel of each picture is a Gaussian, row by row. Positions are sign(n) (e^|n| - 1) with n of 16 bits between bounds,
from a picture of low bytes and one of high bytes. Of a rotation the pixel's alpha, 252 to 255, names the component that
is left out. In version 2 bytes of sizes, colours and SH are places in a codebook, and alpha of a colour is opacity. In
version 1, which has no number, they lie evenly between bounds, and alpha of a colour is a logit. SH is a palette of 64
entries a line; the labels in it are 16 bits of red and green.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError
from airgs_codec.media.image import decode_rgba
from airgs_codec.scene.formats.form import FrameFormat, FrameHeader, Holds, check_count
from airgs_codec.scene.formats.packed import write_with_library
from airgs_codec.scene.gaussians import SH_REST, Gaussians, logits_of

META_NAME = "meta.json"
LABELS_A_LINE = 64  # entries of a palette of SH in a line of its picture
_MOST_META = 1 << 22  # bytes of an archive beyond four times its own size
_MOST_SPARE = 1 << 20  # pixels of a picture beyond two a Gaussian: as the largest palette of SH has
_PACKED = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # zipfile unpacks others past the size that an entry states
_ROWS = ("quats", "scales", "sh0")  # parts of one picture each, a pixel a Gaussian
Meta = dict[str, Any]
Pixels = NDArray[np.uint8]  # (H W, 4) of a picture


def is_sog_folder(folder: Path) -> bool:
    """Return whether a folder is one frame: its meta.json names pictures of means."""
    try:
        return folder.is_dir() and "means" in json.loads((folder / META_NAME).read_bytes())
    except (OSError, ValueError, TypeError, RecursionError):
        return False


def read_sog_header(path: Path) -> FrameHeader:
    """Return count and SH degree by meta.json and, of version 1, the size of a picture. Raises SceneError."""
    return _open(path, rows=False)[1]


def read_sog(path: Path) -> Gaussians:
    """Read one frame. Raises SceneError; pictures larger than the rows need are not unpacked."""
    meta, header, files = _open(path, rows=True)
    return decode_rows(meta, {name: unpack(name, data, header.count) for name, data in files.items()}, header)


def write_sog(path: Path, gaussians: Gaussians) -> None:
    write_with_library(path, "sog", gaussians)


def write_sog_folder(folder: Path, gaussians: Gaussians) -> None:
    """Write one frame of unit quaternions as meta.json and pictures in an existing folder. Raises SceneError."""
    archive = folder / "frame.sog"
    write_sog(archive, gaussians)
    with zipfile.ZipFile(archive) as opened:
        opened.extractall(folder)
    archive.unlink()


def _open(path: Path, *, rows: bool) -> tuple[Meta, FrameHeader, dict[str, bytes]]:
    """Return what meta.json says, and the pictures that it names, or those that the header needs."""
    meta = json.loads(_read_files(path, [META_NAME])[META_NAME])
    if meta.get("version") not in (None, 1, 2) or "means" not in meta:
        raise SceneError(f"{path}: expected SOG of version 1 or 2, got {meta.get('version', 'none')!r}"[:300])
    pictures = {"means": 2, **dict.fromkeys(_ROWS, 1)} | ({"shN": 2} if "shN" in meta else {})
    names = [name for part in pictures for name in meta[part]["files"]]
    plain = all(isinstance(name, str) and name and Path(name).name == name for name in names)
    if not plain or [len(meta[part]["files"]) for part in pictures] != [*pictures.values()]:
        raise ValueError(f"plain names of {sum(pictures.values())} files, got {names}")
    palette = meta["shN"]["files"][0] if "shN" in meta and not _coded(meta) else None
    files = _read_files(path, names if rows else [palette] if palette else [])
    count, bands = (meta["count"], 0) if _coded(meta) else (meta["means"]["shape"][0], 0)
    if palette:
        bands = [LABELS_A_LINE * k for k in SH_REST].index(decode_rgba(files[palette], "WEBP").shape[1])
    elif "shN" in meta:
        bands = meta["shN"]["bands"]
    if bands not in range(len(SH_REST)):
        raise ValueError(f"{bands} bands of SH")
    return meta, check_count(path / names[0] if path.is_dir() else path, FrameHeader(int(count), bands)), files


def _coded(meta: Meta) -> bool:
    """Return whether values are places in codebooks, as in version 2."""
    return meta.get("version") == 2


def _read_files(path: Path, names: list[str]) -> dict[str, bytes]:
    """Return files of a folder, or of an archive by their names without folders.

    Raises LookupError for one that is not in it, ValueError, before memory is taken, for an archive that would unpack
    to far more than it is.
    """
    if path.is_dir():
        found = {name: path / name for name in names if (path / name).is_file()}
        return {name: found[name].read_bytes() for name in names}
    with zipfile.ZipFile(path) as archive:
        entries = {Path(entry.filename).name: entry for entry in archive.infolist()}
        wanted = {name: entries[name] for name in names}
        if other := [name for name, entry in wanted.items() if entry.compress_type not in _PACKED]:
            raise ValueError(f"{other[0][:80]!r} is neither stored nor deflated")
        size = sum(entry.file_size for entry in wanted.values())
        if size > 4 * path.stat().st_size + _MOST_META:
            raise ValueError(f"an archive that unpacks to {size} bytes")
        return {name: archive.read(entry) for name, entry in wanted.items()}


def unpack(name: str, data: bytes, count: int) -> Pixels:
    """Return the pixels of a picture, if it has no more than `count` Gaussians can need. Raises ValueError."""
    try:
        return decode_rgba(data, "WEBP", most_pixels=2 * count + _MOST_SPARE).reshape(-1, 4)
    except ValueError as error:
        raise ValueError(f"{name}: expected WebP for {count} Gaussians: {error}") from error


def decode_rows(meta: Meta, pixels: Mapping[str, Pixels], header: FrameHeader) -> Gaussians:
    """Return the Gaussians of all pictures. Raises LookupError and ValueError for what the pictures do not hold."""
    rows = {part: [_rows(pixels[n], header.count) for n in meta[part]["files"]] for part in ("means", *_ROWS)}
    [quats], [sizes], [colours] = (rows[part] for part in _ROWS)
    log_scales = _values(meta, "scales", sizes[:, :3])
    if _coded(meta):
        dc = _values(meta, "sh0", colours[:, :3])
        logits: NDArray[Any] = logits_of(colours[:, 3] / 255)
    else:
        coloured = _values(meta, "sh0", colours)
        dc, logits = coloured[:, :3], coloured[:, 3]
    low, high = (part[:, :3].astype(np.int64) for part in rows["means"])
    logs = _between(meta["means"], low + 256 * high, 65535)
    columns = (np.sign(logs) * np.expm1(np.abs(logs)), _rotations(quats), log_scales, logits, dc)
    rest = np.zeros((header.count, 0, 3))
    if header.sh_degree:
        palette, labels = (pixels[name] for name in meta["shN"]["files"])
        entries = palette[:, :3].reshape(-1, SH_REST[header.sh_degree], 3)
        entries = entries[: meta["shN"]["count"]] if _coded(meta) and "count" in meta["shN"] else entries
        labels = _rows(labels, header.count)
        rest = _values(meta, "shN", entries)[labels[:, 0] + 256 * labels[:, 1].astype(np.int64)]
    return Gaussians(*(np.ascontiguousarray(column, np.float32) for column in (*columns, rest)))


def _rows(pixels: Pixels, count: int) -> Pixels:
    if len(pixels) < count:
        raise ValueError(f"a picture of {len(pixels)} pixels for {count} Gaussians")
    return pixels[:count]


def _values(meta: Meta, part: str, codes: Pixels) -> NDArray[np.float64]:
    """Return what bytes of a part stand for: places in its codebook or, in version 1, between its bounds."""
    return np.asarray(meta[part]["codebook"], np.float64)[codes] if _coded(meta) else _between(meta[part], codes, 255)


def _between(bounds: Meta, codes: NDArray[Any], most: int) -> NDArray[np.float64]:
    """Return (N, C) codes of 0 to `most` as values between `mins` and `maxs` of C channels."""
    low, high = (np.asarray(bounds[name], np.float64) for name in ("mins", "maxs"))
    return low + (high - low) * (codes / most)


def _rotations(pixels: Pixels) -> NDArray[np.float64]:
    """Return (N, 4) unit quaternions w, x, y, z. Raises ValueError for one that leaves no component out."""
    left_out = pixels[:, 3].astype(np.int64) - 252
    if (left_out < 0).any():
        raise ValueError("a rotation whose alpha is not 252 to 255")
    others = (2 * (pixels[:, :3] / 255) - 1) * np.sqrt(0.5)
    missing = np.sqrt(np.maximum(0, 1 - np.square(others).sum(axis=1)))
    places = np.arange(3) + (np.arange(3) >= left_out[:, None])
    quaternions = np.zeros((len(pixels), 4))
    np.put_along_axis(quaternions, places, others, axis=1)
    np.put_along_axis(quaternions, left_out[:, None], missing[:, None], axis=1)
    return quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)


_HOLDS = Holds(
    rounding="positions to 16 bits, rotations and opacities to 8, sizes and colours to 256 levels, SH to a palette",
    keeps_rows=False,
)
SOG = FrameFormat("SOG", "sog", (".sog", ".zip"), read_sog_header, read_sog, write_sog, _HOLDS)
