"""TSOG, SOG with time, as files of whole frames: version 4 in the playback profile 1.0.1, written and read back.

A ZIP of meta.json and pictures as SOG has them, with codebooks of any length; a discrete timeline gives each of the N
Gaussians one of F frames (TSOG-SPEC.md of OpsiClear-4DGS/ftgs-player).
"""

from __future__ import annotations

import io
import json
import math
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from airgs_codec.scene.formats.form import FrameHeader
from airgs_codec.scene.formats.sog import LABELS_A_LINE, META_NAME, Meta, Pixels, decode_rows, unpack
from airgs_codec.scene.gaussians import SH_REST, Gaussians

PROFILE = {"id": "org.opsiclear.tsog-playback", "version": 1}
LAST_CODE = 65535  # of 16 bits
_ROUNDS = 12  # of fitting a codebook
_PALETTE_NAME, _LABELS = "shN_centroids.webp", "shN_labels.webp"


def write_tsog(path: Path, frames: Sequence[Gaussians], fps: float, *, levels: int, palette: int) -> None:
    """Write frames of unit quaternions and one SH degree; all rows are in memory at once.

    Fewer `levels` of sizes and colours (at least 2) and fewer entries of the palette make a smaller and coarser file.
    """
    step = (1 << 16) // len(frames)
    codes = np.repeat(np.arange(len(frames)), [len(frame) for frame in frames])[:, None] * step + step // 2
    meta: Meta = {"version": 4, "profile": PROFILE, "playback": {"fps": fps}, "count": len(codes)}
    meta["timeline"] = {"type": 0, "N": len(frames), "delta": step}
    pixels = _two(meta["timeline"], "timeline", codes) | _rows(meta, Gaussians.join(frames), levels, palette)
    _write_archive(path, meta, pixels)


def read_tsog(path: Path, frame: int) -> Gaussians:
    """One frame of a file that `write_tsog` wrote."""
    with zipfile.ZipFile(path) as archive:
        meta = json.loads(archive.read(META_NAME))
        names = [name for name in archive.namelist() if name != META_NAME]
        pixels = {name: unpack(name, archive.read(name), meta["count"]) for name in names}
    rows = decode_rows(
        meta | {"version": 2}, pixels, FrameHeader(meta["count"], meta["shN"]["bands"] if "shN" in meta else 0)
    )
    low, high = (pixels[name][: meta["count"], 0].astype(int) for name in meta["timeline"]["files"])
    return rows.take((low + 256 * high) // meta["timeline"]["delta"] == frame)


def _rows(meta: Meta, g: Gaussians, levels: int, entries: int) -> dict[str, Pixels]:
    """What a SOG has as well, with at most so many levels of a codebook and entries of the palette."""
    pixels: dict[str, Pixels] = {}
    meta["means"], codes = _ranged(np.sign(g.means) * np.log1p(np.abs(g.means.astype(np.float64))))
    pixels |= _two(meta["means"], "means", codes)
    for part, values, opacity in (("scales", g.log_scales, None), ("sh0", g.sh_dc, np.rint(g.opacities() * 255))):
        book, codes = _codebook(values, levels)
        meta[part] = {"codebook": book, "files": [f"{part}.webp"]}
        pixels[f"{part}.webp"] = _opaque(codes, opacity)
    meta["quats"], pixels["quats.webp"] = {"files": ["quats.webp"]}, _rotation_pixels(g.quaternions)
    if g.sh_degree:
        palette, labels = _palette(g.sh_rest.reshape(len(g), -1), entries)
        book, codes = _codebook(palette, levels)
        meta["shN"] = {"bands": g.sh_degree, "count": len(palette), "codebook": book, "files": [_PALETTE_NAME, _LABELS]}
        pixels[_PALETTE_NAME] = _opaque(codes.reshape(-1, 3))
        pixels[_LABELS] = _opaque(np.stack([labels % 256, labels // 256], axis=1))
    return pixels


def _ranged(values: NDArray[np.floating]) -> tuple[Meta, NDArray[np.int64]]:
    """The range of (N, C) values, channel by channel, and where in it each of them is, in codes of 16 bits."""
    wide = values.astype(np.float64)
    low, high = wide.min(axis=0), wide.max(axis=0)
    codes = np.rint((wide - low) / np.where(high > low, high - low, 1) * LAST_CODE).astype(np.int64)
    return {"mins": low.tolist(), "maxs": high.tolist()}, codes


def _two(part: Meta, name: str, codes: NDArray[np.int64]) -> dict[str, Pixels]:
    """The pictures of low and high bytes of (N, C) codes, which the part then names."""
    part["files"] = [f"{name}_l.webp", f"{name}_u.webp"]
    return dict(zip(part["files"], (_opaque(codes % 256), _opaque(codes // 256)), strict=True))


def _write_archive(path: Path, meta: Meta, pixels: Mapping[str, Pixels]) -> None:
    width = math.ceil(math.sqrt(meta["count"]))
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(zipfile.ZipInfo(META_NAME), json.dumps(meta))
        for name, samples in pixels.items():
            across = LABELS_A_LINE * SH_REST[meta["shN"]["bands"]] if name == _PALETTE_NAME else width
            lines = math.ceil((len(samples) if name == _PALETTE_NAME else meta["count"]) / across)
            padded = np.zeros((lines * across, 4), np.uint8)
            padded[:, 3] = 255
            padded[: len(samples)] = samples
            archive.writestr(zipfile.ZipInfo(name), _webp(padded.reshape(lines, across, 4)))


def _webp(samples: Pixels) -> bytes:
    target = io.BytesIO()
    Image.fromarray(samples).save(target, "WEBP", lossless=True, exact=True)
    return target.getvalue()


def _opaque(codes: NDArray[Any], alpha: NDArray[Any] | None = None) -> Pixels:
    pixels = np.zeros((len(codes), 4), np.uint8)
    pixels[:, : codes.shape[1]] = codes
    pixels[:, 3] = 255 if alpha is None else alpha
    return pixels


def _rotation_pixels(quaternions: NDArray[np.float32]) -> Pixels:
    """(N, 4) unit quaternions without their largest component, which is made positive."""
    largest = np.abs(quaternions).argmax(axis=1)
    turned = quaternions * np.sign(np.take_along_axis(quaternions, largest[:, None], axis=1))
    places = np.arange(3) + (np.arange(3) >= largest[:, None])
    kept = np.take_along_axis(turned, places, axis=1) * np.sqrt(2)
    return _opaque(np.rint(np.clip((kept + 1) / 2, 0, 1) * 255), 252 + largest)


def _codebook(values: NDArray[np.float32], most: int) -> tuple[list[float], NDArray[np.int64]]:
    """At most so many levels, and the nearest of each value: Lloyd's iterations from quantiles and even steps."""
    flat = values.astype(np.float64).ravel()
    levels = np.unique(flat)
    if len(levels) > most:
        half = most // 2
        levels = np.unique(
            [*np.quantile(flat, (np.arange(half) + 0.5) / half), *np.linspace(levels[0], levels[-1], half)]
        )
        for _ in range(_ROUNDS):
            codes = np.searchsorted((levels[1:] + levels[:-1]) / 2, flat)
            counts = np.bincount(codes, minlength=len(levels))
            sums = np.bincount(codes, flat, len(levels))
            levels = sums[counts > 0] / counts[counts > 0]
    codes = np.searchsorted((levels[1:] + levels[:-1]) / 2, flat)
    return levels.tolist(), codes.reshape(values.shape)


def _palette(rows: NDArray[np.float32], most: int) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """(P, D) means of at most so many cells of (N, D) rows, and the cell of each row.

    All cells are halved again and again, each at its mean along the axis on which it spreads most.
    """
    labels = np.zeros(len(rows), np.int64)
    while True:
        cells = int(labels.max()) + 1
        counts = np.bincount(labels)
        means = np.stack([np.bincount(labels, column) / counts for column in rows.T], axis=1)
        apart = rows - means[labels]
        spread = np.stack([np.bincount(labels, np.square(column)) for column in apart.T], axis=1)
        axis = spread.argmax(axis=1)
        upper = np.take_along_axis(apart, axis[labels][:, None], axis=1)[:, 0] > 0
        split = np.unique(2 * labels + upper, return_inverse=True)[1]
        if split.max() + 1 == cells or split.max() >= most:
            return means.astype(np.float32), labels
        labels = split
