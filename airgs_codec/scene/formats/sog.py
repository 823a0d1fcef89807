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
from airgs_codec.scene.files import expecting
from airgs_codec.scene.formats.form import FrameFormat, FrameHeader, Holds, check_count
from airgs_codec.scene.formats.packed import LIBRARY, write_with_library
from airgs_codec.scene.gaussians import SH_REST, Gaussians, logits_of

META_NAME = "meta.json"
LABELS_A_LINE = 64  # entries of a palette of SH in a line of its picture
_MOST_META = 1 << 22  # bytes
_MOST_SPARE = 1 << 20  # pixels of a picture beyond two a Gaussian: the largest palette of SH has so many
_MOST_PICTURE = 1 << 29  # bytes
_MOST_FILES = 1024
_PACKED = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # zipfile unpacks others past the size that an entry states
_MOST_CHUNKS = 16  # before the pixels of a picture
_LEVELS = 256  # of a codebook
_ROWS = ("quats", "scales", "sh0")  # parts of one picture each, a pixel a Gaussian
_PICTURES = {"means": 2, **dict.fromkeys(_ROWS, 1), "shN": 2}
Meta = dict[str, Any]
Pixels = NDArray[np.uint8]  # (H W, 4) of a picture


def is_sog_folder(folder: Path) -> bool:
    """Return whether a folder is one frame: its meta.json names pictures of means."""
    try:
        return folder.is_dir() and "means" in json.loads(_read_at_most(folder / META_NAME, _MOST_META))
    except (OSError, ValueError, TypeError, RecursionError):
        return False


def read_sog_header(path: Path) -> FrameHeader:
    """Count and SH degree, from meta.json and, of version 1, the size of a picture. Raises SceneError."""
    return _open(path, rows=False)[1]


def read_sog(path: Path) -> Gaussians:
    """Reads one frame. Raises SceneError; pictures larger than the rows need are not unpacked."""
    meta, header, files = _open(path, rows=True)
    with expecting(path, "SOG"):
        return decode_rows(meta, {name: unpack(name, data, header.count) for name, data in files.items()}, header)


def write_sog(path: Path, gaussians: Gaussians) -> None:
    write_with_library(path, "sog", gaussians)


def write_sog_folder(folder: Path, gaussians: Gaussians) -> None:
    """Writes one frame of unit quaternions as meta.json and pictures in an existing folder. Raises SceneError."""
    archive = folder / "frame.sog"
    write_sog(archive, gaussians)
    with zipfile.ZipFile(archive) as opened:
        opened.extractall(folder)
    archive.unlink()


def _open(path: Path, *, rows: bool) -> tuple[Meta, FrameHeader, dict[str, bytes]]:
    """What meta.json says, and the pictures that it names, or those that the header needs. Raises SceneError."""
    with expecting(path, f"SOG, a {META_NAME} with WebP pictures"):
        meta = json.loads(_read_files(path, [META_NAME])[META_NAME])
    with expecting(path, f"{META_NAME} of a SOG file"):
        if meta.get("version") not in (None, 1, 2) or "means" not in meta:
            raise SceneError(f"{path}: expected SOG of version 1 or 2, got {meta.get('version', 'none')!r}"[:300])
        names = _check_meta(meta)
    with expecting(path, f"pictures of SOG beside {META_NAME}"):
        sizing = meta["shN"]["files"][:1] if "shN" in meta and not _coded(meta) else []
        files = _read_files(path, names if rows else sizing)
        header = FrameHeader(_count(meta), _bands(meta, files))
    return meta, check_count(path / names[0] if path.is_dir() else path, header), files


def _check_meta(meta: Meta) -> list[str]:
    """The pictures that meta.json names. Raises what `expecting` knows."""
    names: list[str] = []
    for part, number in _PICTURES.items():
        files = meta[part]["files"] if part in meta else []
        plain = all(isinstance(name, str) and name and Path(name).name == name for name in files)
        if len(files) != number * (part in meta) or not plain:
            raise ValueError(f"{part}: expected {number} plain names of files")
        names += files
    whole = len(meta["means"]["mins"]) == len(meta["means"]["maxs"]) == 3 and len(names) >= 5 and _count(meta) >= 0
    for part in {"scales", "sh0", "shN"} & {*meta} if _coded(meta) else ():
        book = meta[part]["codebook"]
        whole &= len(book) == _LEVELS and all(isinstance(value, int | float) for value in book)
    if not whole:
        raise ValueError("counts, bounds or codebooks that are not SOG's")
    return names


def _coded(meta: Meta) -> bool:
    return meta.get("version") not in (None, 1)


def _count(meta: Meta) -> int:
    return int(meta["count"] if _coded(meta) else meta["means"]["shape"][0])


def _bands(meta: Meta, files: Mapping[str, bytes]) -> int:
    if "shN" not in meta:
        return 0
    if _coded(meta):
        bands = int(meta["shN"]["bands"])
    else:
        name = meta["shN"]["files"][0]
        bands = [LABELS_A_LINE * k for k in SH_REST].index(_picture_size(name, files[name])[0])
    if not 0 <= bands < len(SH_REST):
        raise ValueError(f"{bands} bands of SH")
    return bands


def _read_files(path: Path, names: list[str]) -> dict[str, bytes]:
    """Files of a folder or an archive, by name. Raises ValueError, OSError."""
    if not path.is_dir():
        return _read_entries(path, names)
    if missing := [name for name in names if not (path / name).is_file()]:
        raise ValueError(f"no {missing[0]}")
    return {name: _read_at_most(path / name, _MOST_META if name == META_NAME else _MOST_PICTURE) for name in names}


def _read_entries(path: Path, names: list[str]) -> dict[str, bytes]:
    """Files of an archive with a meta.json, by name without folders.

    Raises ValueError, before memory is taken, for one that would unpack to far more than it is or lacks a name.
    """
    with zipfile.ZipFile(path) as archive:
        listed = archive.infolist()
        entries = {Path(entry.filename).name: entry for entry in listed}
        if META_NAME not in entries or len(listed) > _MOST_FILES:
            there = "" if META_NAME in entries else "not "
            raise ValueError(f"{len(listed)} files, {META_NAME} {there}among them")
        if missing := [name for name in names if name not in entries]:
            raise ValueError(f"no {missing[0][:80]!r}")
        wanted = {name: entries[name] for name in names}
        other = [n for n, entry in wanted.items() if entry.compress_type not in _PACKED or entry.flag_bits & 1]
        if other:
            raise ValueError(f"{other[0][:80]!r} is neither stored nor deflated")
        size = sum(entry.file_size for entry in wanted.values())
        if size > 4 * path.stat().st_size + _MOST_META or entries[META_NAME].file_size > _MOST_META:
            raise ValueError(f"an archive that unpacks to {size} bytes")
        return {name: archive.read(entry) for name, entry in wanted.items()}


def _read_at_most(path: Path, most: int) -> bytes:
    with path.open("rb") as file:
        data = file.read(most + 1)
    if len(data) > most:
        raise ValueError(f"{path.name} of more than {most} bytes")
    return data


def _picture_size(name: str, data: bytes) -> tuple[int, int]:
    """Width and height of still lossless WebP, which its header tells. Raises ValueError for anything else."""
    if data[:4] != b"RIFF" or data[8:12] != b"WEBP":
        raise ValueError(f"{name} is no WebP but {data[:12]!r}")
    at, kinds = 12, list[bytes]()
    while at + 13 <= len(data) and len(kinds) < _MOST_CHUNKS:
        kinds.append(data[at : at + 4])
        if kinds[-1] == b"VP8L":
            bits = int.from_bytes(data[at + 9 : at + 13], "little")
            return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
        if kinds[-1] in (b"VP8 ", b"ANMF", b"ALPH"):
            break
        size = int.from_bytes(data[at + 4 : at + 8], "little")
        at += 8 + size + size % 2
    raise ValueError(f"{name} is no lossless WebP but {b' '.join(kinds)[:80]!r}")


def unpack(name: str, data: bytes, count: int) -> Pixels:
    """The pixels of a picture, if it has no more than `count` Gaussians can need. Raises ValueError."""
    width, height = _picture_size(name, data)
    if width * height > 2 * count + _MOST_SPARE:
        raise ValueError(f"{name} for {count} Gaussians, got {width} x {height} pixels")
    samples = decode_rgba(data, "WEBP")
    if samples.shape[:2] != (height, width):
        raise ValueError(f"{name} of {width} x {height} pixels, got {samples.shape[1]} x {samples.shape[0]}")
    return samples.reshape(-1, 4)


def decode_rows(meta: Meta, pixels: Mapping[str, Pixels], header: FrameHeader) -> Gaussians:
    """The Gaussians of all pictures. Raises LookupError and ValueError for what the pictures do not hold."""
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
    """What bytes of a part stand for: places in its codebook or, in version 1, between its bounds."""
    return np.asarray(meta[part]["codebook"], np.float64)[codes] if _coded(meta) else _between(meta[part], codes, 255)


def _between(bounds: Meta, codes: NDArray[Any], most: int) -> NDArray[np.float64]:
    """(N, C) codes of 0 to `most` as values between `mins` and `maxs` of C channels."""
    low, high = (np.asarray(bounds[name], np.float64) for name in ("mins", "maxs"))
    return low + (high - low) * (codes / most)


def _rotations(pixels: Pixels) -> NDArray[np.float64]:
    """(N, 4) unit quaternions w, x, y, z. Raises ValueError for one that leaves no component out."""
    left_out = pixels[:, 3].astype(np.int64) - 252
    if (left_out < 0).any():
        raise ValueError("a rotation whose alpha is not 252 to 255")
    kept = (2 * (pixels[:, :3] / 255) - 1) * np.sqrt(0.5)
    missing = np.sqrt(np.maximum(0, 1 - np.square(kept).sum(axis=1)))
    places = np.arange(3) + (np.arange(3) >= left_out[:, None])  # of the three others
    quaternions = np.zeros((len(pixels), 4))
    np.put_along_axis(quaternions, places, kept, axis=1)
    np.put_along_axis(quaternions, left_out[:, None], missing[:, None], axis=1)
    return quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)


_HOLDS = Holds(
    rounding="positions to 16 bits, rotations and opacities to 8, sizes and colours to 256 levels, SH to a palette",
    keeps_rows=False,
)
SOG = FrameFormat("SOG", "sog", (".sog", ".zip"), read_sog_header, read_sog, write_sog, _HOLDS, writer=LIBRARY)
