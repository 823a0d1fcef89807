"""TSOG, SOG with time: version 4 in the playback profile 1.0.1 (TSOG-SPEC.md of OpsiClear-4DGS/ftgs-player).

A ZIP of meta.json, pictures as SOG has them, with codebooks of any length, and a file of sound. Its timeline is
discrete, every Gaussian in one frame of F; or continuous, every Gaussian with a centre and a standard deviation in time
and, where `temporal` says so, a velocity; or there is none and all is still. N Gaussians of all frames.
"""

from __future__ import annotations

import functools
import json
import math
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec.media.image import to_floats
from airgs_codec.scene.beside import DEFAULT_FPS, frame_rate
from airgs_codec.scene.files import expecting, reading
from airgs_codec.scene.formats.form import (
    Bake,
    Clip,
    ClipFormat,
    FrameHeader,
    Holds,
    check_count,
    count_frames,
    rate_words,
    refuse_baking,
)
from airgs_codec.scene.formats.ftgs import FRAMES
from airgs_codec.scene.formats.moving import Moving, baked_note, moving_clip
from airgs_codec.scene.formats.sog import (
    LABELS_A_LINE,
    META_NAME,
    Meta,
    Pixels,
    between,
    decode_rows,
    picture_size,
    read_entries,
    unpack,
    wide,
)
from airgs_codec.scene.formats.tsog_meta import LAST_CODE, VERSION, check_meta, image_names
from airgs_codec.scene.formats.tsog_write import write_tsog
from airgs_codec.scene.gaussians import SATURATED_LOGIT, SH_REST, Gaussians

_MOST_SOUND = 1 << 27  # bytes
_CACHED = 2  # files of a process


@dataclass(frozen=True, slots=True, eq=False)
class _Frames:
    """All rows of a discrete file, frame by frame, and where each begins, (F + 1,)."""

    rows: Gaussians
    starts: NDArray[np.int64]


def open_tsog(path: Path, bake: Bake) -> Clip:
    """The frames of a file, baked where its timeline is continuous. Raises SceneError."""
    meta = _read_meta(path)
    check_count(path, _header(meta))
    kind, playback = meta.get("timeline", {}).get("type"), meta.get("playback", {})
    stated = Fraction(str(playback["duration"])) if "duration" in playback else None
    if stated is not None:
        refuse_baking(path, bake, "its playback", fps=False)
    rate = frame_rate(str(path), playback.get("fps", meta.get("fps", DEFAULT_FPS)))
    if kind == 0:
        refuse_baking(path, bake, "a discrete .tsog")
        clip = _open_discrete(path, rate if stated is None else frame_rate(str(path), meta["timeline"]["N"] / stated))
    else:
        fps, seconds = bake.fps or rate, stated if bake.seconds is None else bake.seconds
        clip = _open_continuous(path, kind, (rate, fps), seconds)
    sound = functools.partial(_read_sound, meta["audio"]["file"]) if "audio" in meta else None
    return replace(clip, note=clip.note + _extras(meta), sound=sound)


def _open_continuous(path: Path, kind: int | None, rates: tuple[Fraction, Fraction], seconds: Fraction | None) -> Clip:
    """Frames of Gaussians that move and fade, or of still ones where `kind` is None; `rates`: stated, wished for."""
    rate, fps = rates
    stated = seconds is not None
    if kind is None:
        frames = 1 if seconds is None else count_frames(path, fps, seconds)
        length, last = (seconds or 1 / fps), frames
    else:
        length = seconds if seconds is not None else (FRAMES - 1) / rate
        count_frames(path, fps, length)  # which refuses what has no end
        frames = max(2, math.floor(length * fps + Fraction(1, 2)) + 1)
        last = frames - 1
    clip = moving_clip(_read_moving, path, frames, fps, last)
    name = ".tsog, still" if kind is None else ".tsog, continuous"
    return replace(clip, note=baked_note(name, clip, length, stated))


def _open_discrete(path: Path, fps: Fraction) -> Clip:
    with reading(path):
        found = _frames(path, path.stat().st_mtime_ns)
    counts = np.maximum(1, np.diff(found.starts))
    known = {count: FrameHeader(count, found.rows.sh_degree) for count in set(counts.tolist())}
    headers = tuple(known[count] for count in counts.tolist())
    numbers = f"{counts.min()} to {counts.max()}" if len(known) > 1 else f"{counts[0]}"
    note = f".tsog, discrete: {numbers} Gaussians in {len(headers)} frames at {rate_words(fps)}"
    return Clip(headers, fps, _read_discrete, note)


def _extras(meta: Meta) -> str:
    """What a player is told beyond frames, for people."""
    words, audio = "", meta.get("audio")
    if audio is not None:
        volume = audio.get("volume", 1)
        words += f"; sound from {audio['file']}" + (
            "" if volume == 1 else f", to be played at {volume:g} of its volume"
        )
    rate = meta.get("playback", {}).get("rate", 1)
    return words + ("" if rate == 1 else f"; to be played at {rate:g} times its speed")


def _read_discrete(path: Path, frame: int) -> Gaussians:
    """One frame; one without Gaussians has one that nobody sees. Raises SceneError."""
    with reading(path):
        found = _frames(path, path.stat().st_mtime_ns)
    start, stop = found.starts[frame : frame + 2]
    if start < stop:
        return found.rows.take(slice(start, stop))
    return replace(found.rows.take(slice(0, 1)), opacity_logits=np.full(1, -SATURATED_LOGIT))


@functools.lru_cache(maxsize=_CACHED)
def _frames(path: Path, _written: int) -> _Frames:
    """All frames of a discrete file, in the order of their rows. Raises SceneError."""
    meta, pixels = _read(path)
    line = meta["timeline"]
    codes = wide(*(pixels[name][: meta["count"]] for name in line["files"]))[:, 0]
    frames = np.minimum(line["N"] - 1, codes // line["delta"])
    rows = _decode(path, meta, pixels).take(np.argsort(frames, kind="stable"))
    return _Frames(rows, np.concatenate([[0], np.cumsum(np.bincount(frames, minlength=line["N"]))]))


def _read_moving(path: Path) -> Moving:
    """The model of a file that is continuous or still. Raises SceneError."""
    meta, pixels = _read(path)
    rows, count = _decode(path, meta, pixels), meta["count"]
    motion = np.zeros((count, 0, 3), np.float32)
    if "timeline" not in meta:
        return Moving(rows, motion, rows.opacities(), np.zeros(count, np.float32), np.full(count, np.inf, np.float32))
    centres, deviations = between(meta["timeline"], _codes(meta["timeline"], pixels, count)[:, :2], LAST_CODE).T
    if "temporal" in meta:
        part = meta["temporal"]["means"]
        codes = _codes(part, pixels, count)[:, :3]
        motion = between(part, codes, LAST_CODE if len(part["files"]) == 2 else 255).astype(np.float32)[:, None]
    alpha = to_floats(pixels[meta["sh0"]["files"][0]][:count, 3])
    widths = (deviations * math.sqrt(2)).astype(np.float32)
    return Moving(rows, motion, alpha, centres.astype(np.float32), widths)


def _codes(part: Meta, pixels: Mapping[str, Pixels], count: int) -> NDArray[np.int64]:
    """(N, 4) codes of one picture, or of one of low and one of high bytes."""
    found = [pixels[name][:count] for name in part["files"]]
    return wide(*found) if len(found) == 2 else found[0].astype(np.int64)


def _header(meta: Meta) -> FrameHeader:
    return FrameHeader(meta["count"], meta["shN"]["bands"] if "shN" in meta else 0)


def _read_meta(path: Path) -> Meta:
    """What meta.json says. Raises SceneError."""
    with expecting(path, f"TSOG of version {VERSION}, a ZIP with {META_NAME}"), zipfile.ZipFile(path) as archive:
        meta = json.loads(read_entries(path, archive, [META_NAME])[META_NAME])
        check_meta(meta)
    return dict(meta)


def _read(path: Path) -> tuple[Meta, dict[str, Pixels]]:
    """What meta.json says, and the pixels of all pictures. Raises SceneError."""
    meta = _read_meta(path)
    check_count(path, _header(meta))
    with expecting(path, "pictures of TSOG"):
        with zipfile.ZipFile(path) as archive:
            files = read_entries(path, archive, image_names(meta))
        sizes = {name: picture_size(name, data) for name, data in files.items()}
        palette = meta["shN"]["files"][0] if "shN" in meta else ""
        [(width, height), *others] = {size for name, size in sizes.items() if name != palette}
        if others or width * height < meta["count"]:
            raise ValueError(f"{meta['count']} Gaussians in pictures of one size, got {width} x {height}")
        if palette:
            degree, entries = meta["shN"]["bands"], meta["shN"]["count"]
            expected = (LABELS_A_LINE * SH_REST[degree], math.ceil(entries / LABELS_A_LINE))
            if sizes[palette] != expected:
                raise ValueError(f"a palette of {expected}, got {sizes[palette]}")
        return meta, {name: unpack(name, data, meta["count"]) for name, data in files.items()}


def _decode(path: Path, meta: Meta, pixels: Mapping[str, Pixels]) -> Gaussians:
    with expecting(path, "Gaussians of TSOG"):
        return decode_rows(meta, pixels, _header(meta))


def _read_sound(name: str, path: Path) -> bytes:
    """The file of sound. Raises SceneError."""
    with expecting(path, f"sound in {name}"), zipfile.ZipFile(path) as archive:
        entry = archive.getinfo(name)
        if not 0 < entry.file_size <= _MOST_SOUND or entry.compress_type not in (0, 8):
            raise ValueError(f"{entry.file_size} bytes")
        return archive.read(entry)


TSOG = ClipFormat(
    name=".tsog",
    key="tsog",
    suffixes=(".tsog",),
    open=open_tsog,
    write=write_tsog,
    holds=Holds(
        rounding="positions to 16 bits, rotations and opacities to 8, sizes and colours to 256 levels, SH to a palette"
        ", and motion that is nearly even to what is",
        sound=True,
    ),
)
