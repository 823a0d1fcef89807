"""TSOG as it is written: discrete frames, or Gaussians that move evenly on a continuous timeline. N rows in all."""

from __future__ import annotations

import json
import math
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError
from airgs_codec.media.image import encode_webp
from airgs_codec.scene.formats.moving import MOST_OFF, Moving, even_motion
from airgs_codec.scene.formats.sog import LABELS_A_LINE, META_NAME, Meta, Pixels
from airgs_codec.scene.formats.tsog_meta import LAST_CODE, MOST_DISCRETE, PROFILE, VERSION
from airgs_codec.scene.gaussians import SH_REST, Gaussians, join_rows

LEVELS = 256  # of a codebook, at most
_ROUNDS = 12  # of fitting a codebook
PALETTE = 1 << 16  # entries of the palette of SH, at most
_PALETTE_NAME, _LABELS = "shN_centroids.webp", "shN_labels.webp"
_SOUND = "sound.m4a"


def write_tsog(
    path: Path,
    frames: Iterable[Gaussians],
    fps: float,
    sound: bytes = b"",
    levels: int = LEVELS,
    palette: int = PALETTE,
) -> None:
    """Write frames of unit quaternions and one SH degree, with a sound in MP4; all rows are in memory at once.

    Fewer `levels` of sizes and colours (at least 2) and fewer entries of the palette make a smaller and coarser file.

    Where their Gaussians move evenly (`even_motion`), the file is continuous, else discrete. Raises SceneError for more
    frames than a timeline can number.
    """
    parts = list(frames)
    if len(parts) > MOST_DISCRETE:
        raise SceneError(f"{path}: expected at most {MOST_DISCRETE} frames, got {len(parts)}")
    meta: Meta = {"version": VERSION, "profile": PROFILE, "playback": {"fps": fps}}
    even = even_motion(parts) if len(parts) > 1 else None
    if even is not None and even.off <= MOST_OFF:
        meta["playback"]["duration"] = (len(parts) - 1) / fps
        g, alpha = even.moving.rest, even.moving.alpha
        pixels = _continuous(meta, even.moving)
    else:
        g = join_rows(parts)
        alpha, pixels = g.opacities(), _discrete(meta, [len(part) for part in parts])
    meta["count"] = len(g)
    pixels |= _rows(meta, g, alpha, (levels, palette))
    if sound:
        meta["audio"] = {"file": _SOUND, "mimeType": "audio/mp4"}
    _write_archive(path, meta, pixels, sound)


def _discrete(meta: Meta, counts: Sequence[int]) -> dict[str, Pixels]:
    """The timeline of frames of so many rows each."""
    step = (1 << 16) // len(counts)
    codes = np.repeat(np.arange(len(counts)), counts)[:, None] * step + step // 2
    meta["timeline"] = {"type": 0, "N": len(counts), "delta": step}
    return _two(meta["timeline"], "timeline", codes)


def _continuous(meta: Meta, m: Moving) -> dict[str, Pixels]:
    """The timeline and the velocities of Gaussians that move evenly."""
    meta["timeline"], codes = _ranged(np.stack([m.centres, m.widths / math.sqrt(2)], axis=1))
    meta["timeline"]["type"] = 1
    motion, speeds = _ranged(m.motion[:, 0])
    meta["temporal"] = {"means": {"mins": [motion["mins"]], "maxs": [motion["maxs"]]}}
    return _two(meta["timeline"], "timeline", codes) | _two(meta["temporal"]["means"], "velocity", speeds)


def _rows(meta: Meta, g: Gaussians, alpha: NDArray[np.float32], most: tuple[int, int]) -> dict[str, Pixels]:
    """What a SOG has as well; `most` levels of a codebook and entries of the palette."""
    pixels: dict[str, Pixels] = {}
    meta["means"], codes = _ranged(np.sign(g.means) * np.log1p(np.abs(g.means.astype(np.float64))))
    pixels |= _two(meta["means"], "means", codes)
    for part, values, opacity in (("scales", g.log_scales, None), ("sh0", g.sh_dc, np.rint(alpha * 255))):
        book, codes = _codebook(values, most[0])
        meta[part] = {"codebook": book, "files": [f"{part}.webp"]}
        pixels[f"{part}.webp"] = _opaque(codes, opacity)
    meta["quats"], pixels["quats.webp"] = {"files": ["quats.webp"]}, _rotation_pixels(g.quaternions)
    if g.sh_degree:
        palette, labels = _palette(g.sh_rest.reshape(len(g), -1), most[1])
        book, codes = _codebook(palette, most[0])
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


def _write_archive(path: Path, meta: Meta, pixels: Mapping[str, Pixels], sound: bytes) -> None:
    width = math.ceil(math.sqrt(meta["count"]))
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(zipfile.ZipInfo(META_NAME), json.dumps(meta))
        for name, samples in pixels.items():
            across = LABELS_A_LINE * SH_REST[meta["shN"]["bands"]] if name == _PALETTE_NAME else width
            lines = math.ceil((len(samples) if name == _PALETTE_NAME else meta["count"]) / across)
            padded = np.zeros((lines * across, 4), np.uint8)
            padded[:, 3] = 255
            padded[: len(samples)] = samples
            archive.writestr(zipfile.ZipInfo(name), encode_webp(padded.reshape(lines, across, 4)))
        if sound:
            archive.writestr(zipfile.ZipInfo(_SOUND), sound)


def _opaque(codes: NDArray[Any], alpha: NDArray[Any] | None = None) -> Pixels:
    """(N, C) bytes of up to three channels as pixels."""
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
