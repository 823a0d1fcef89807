"""PlayCanvas' SOG, version 2: a meta.json and lossless WebP pictures, in a folder or a .sog or .zip; SH 0 to 3."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path
from typing import Any

from airgs_codec.errors import SceneError
from airgs_codec.scene.files import expecting
from airgs_codec.scene.formats.form import FrameFormat, FrameHeader, Holds, check_count
from airgs_codec.scene.formats.library import LIBRARY, read_with_library, write_with_library
from airgs_codec.scene.gaussians import SH_REST, Gaussians

META_NAME = "meta.json"
_MOST_META = 1 << 20  # bytes
_MOST_SPARE = 1 << 20  # pixels of a picture beyond two a Gaussian: the largest palette of SH has so many
_MOST_FILES = 64
_PACKED = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # zipfile unpacks others past the size that an entry states
_LEVELS = 256  # of a codebook
_PICTURES = {"means": 2, "quats": 1, "scales": 1, "sh0": 1, "shN": 2}
Meta = dict[str, Any]


def is_sog_folder(folder: Path) -> bool:
    """Return whether a folder is one frame: its meta.json names pictures of means."""
    try:
        return folder.is_dir() and "means" in json.loads(_read_at_most(folder / META_NAME, _MOST_META))
    except (OSError, ValueError, TypeError, RecursionError):
        return False


def read_sog_header(path: Path) -> FrameHeader:
    """Count and SH degree, from meta.json. Raises SceneError."""
    return _header(path, _files(path, only_meta=True)[META_NAME])[0]


def read_sog(path: Path) -> Gaussians:
    """One frame. Raises SceneError; pictures larger than the rows need are not unpacked."""
    files = _files(path)
    header, names = _header(path, files[META_NAME])
    if missing := [name for name in names if name not in files]:
        raise SceneError(f"{path}: expected {missing[0]} beside {META_NAME}, got nothing")
    for name in names:
        _check_picture(path, name, files[name], header.count)
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for name in (META_NAME, *names):
            archive.writestr(name, files[name])
    return read_with_library(path, "sog", packed.getvalue(), header)


def write_sog(path: Path, gaussians: Gaussians) -> None:
    """Write one frame of unit quaternions as one archive. Raises SceneError."""
    write_with_library(path, "sog", gaussians)


def write_sog_folder(folder: Path, gaussians: Gaussians) -> None:
    """Write one frame of unit quaternions as meta.json and pictures in an existing folder. Raises SceneError."""
    archive = folder / "frame.sog"
    write_sog(archive, gaussians)
    for name, data in _files(archive).items():
        (folder / name).write_bytes(data)
    archive.unlink()


def _header(path: Path, text: bytes) -> tuple[FrameHeader, list[str]]:
    """Return what meta.json says, and the pictures that it names."""
    with expecting(path, f"{META_NAME} of a SOG file"):
        meta = json.loads(text)
        if meta.get("version") != 2:
            raise SceneError(f"{path}: expected SOG of version 2, got {meta.get('version', 'version 1 or no version')}")
        count, bands = int(meta["count"]), int(meta["shN"]["bands"]) if "shN" in meta else 0
        names = [name for part, number in _PICTURES.items() if part in meta for name in _names(meta, part, number)]
        books = [meta[part]["codebook"] for part in ("scales", "sh0", "shN") if part in meta]
        whole = all(len(book) == _LEVELS and all(isinstance(v, int | float) for v in book) for book in books)
        whole &= len(meta["means"]["mins"]) == len(meta["means"]["maxs"]) == 3 and len(names) >= 5
        if count < 0 or not 0 <= bands < len(SH_REST) or not whole:
            raise ValueError("counts, bands, bounds or codebooks that are not SOG's")
    return check_count(path / names[0] if path.is_dir() else path, FrameHeader(count, bands)), names


def _names(meta: Meta, part: str, number: int) -> list[str]:
    names = meta[part]["files"]
    if len(names) != number or not all(isinstance(n, str) and n and Path(n).name == n for n in names):
        raise ValueError(f"{part}: expected {number} plain names of files")
    return list(names)


def _files(path: Path, *, only_meta: bool = False) -> dict[str, bytes]:
    """meta.json and, unless only that is asked for, what else lies beside it, by name."""
    with expecting(path, f"SOG, a {META_NAME} with WebP pictures"):
        if path.is_dir():
            meta = _read_at_most(path / META_NAME, _MOST_META)
            names = [] if only_meta else _header(path, meta)[1]
            return {META_NAME: meta} | {name: (path / name).read_bytes() for name in names if (path / name).is_file()}
        with zipfile.ZipFile(path) as archive:
            return _unzip(path, archive, only_meta)


def _unzip(path: Path, archive: zipfile.ZipFile, only_meta: bool) -> dict[str, bytes]:
    entries = {Path(entry.filename).name: entry for entry in archive.infolist()}
    if META_NAME not in entries or len(entries) > _MOST_FILES:
        raise ValueError(f"{len(entries)} files, {META_NAME} {'' if META_NAME in entries else 'not '}among them")
    if other := [entry.filename for entry in entries.values() if entry.compress_type not in _PACKED]:
        raise ValueError(f"{other[0][:80]!r} is neither stored nor deflated")
    wanted = {META_NAME: entries[META_NAME]} if only_meta else entries
    size = sum(entry.file_size for entry in wanted.values())  # no more than that is ever unpacked
    if entries[META_NAME].file_size > _MOST_META or size > 4 * path.stat().st_size + _MOST_META:
        raise ValueError(f"an archive that unpacks to {size} bytes")
    return {name: archive.read(entry) for name, entry in wanted.items()}


def _read_at_most(path: Path, most: int) -> bytes:
    with path.open("rb") as file:
        data = file.read(most + 1)
    if len(data) > most:
        raise ValueError(f"{path.name} of more than {most} bytes")
    return data


def _check_picture(path: Path, name: str, data: bytes, count: int) -> None:
    """Refuse what is no lossless WebP, or has more pixels than the rows can need."""
    if data[:4] != b"RIFF" or data[8:12] != b"WEBP" or len(data) < 30:
        raise SceneError(f"{path}: expected {name} to be WebP, got {data[:12]!r}")
    if data[12:16] == b"VP8L":
        bits = int.from_bytes(data[21:25], "little")
        width, height = 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
    elif data[12:16] == b"VP8X":
        width, height = (1 + int.from_bytes(data[at : at + 3], "little") for at in (24, 27))
    else:
        raise SceneError(f"{path}: expected {name} to be lossless WebP, got {data[12:16]!r}")
    if width * height > 2 * count + _MOST_SPARE:
        raise SceneError(f"{path}: expected {name} for {count} Gaussians, got {width} x {height} pixels")


SOG = FrameFormat(
    name="SOG",
    key="sog",
    suffixes=(".sog", ".zip"),
    read_header=read_sog_header,
    read=read_sog,
    write=write_sog,
    holds=Holds(
        rounding="positions to 16 bits, rotations and opacities to 8, sizes and colours to 256 levels, SH to a palette",
        keeps_rows=False,
    ),
    writer=LIBRARY,
)
