"""Clips that only their own libraries read: Avala's .4dgs with fourdgs, splats4D's .splat4d with its command."""

from __future__ import annotations

import functools
import json
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from airgs_codec.errors import SceneError
from airgs_codec.scene.arrays import clip_of
from airgs_codec.scene.beside import MAX_FPS, exact_number
from airgs_codec.scene.files import Cursor, expecting
from airgs_codec.scene.formats.form import Bake, Clip, ClipFormat, FrameHeader, check_count, count_frames
from airgs_codec.scene.formats.library import expect_library
from airgs_codec.scene.formats.sandbox import SECONDS, run_limited
from airgs_codec.scene.formats.splat import ROW_BYTES, read_splat
from airgs_codec.scene.gaussians import SH_C0, Gaussians, logits_of, logs_of

_COPIES = 128  # of the bytes of a .4dgs in the library, at least
_SECONDS_PER_BYTE = 5e-6  # about five times what the library takes
_ROW_COPIES = 64  # of a row of .splat, in the command
_MOST_JSON = 1 << 24  # bytes


def open_4dgs(path: Path, bake: Bake) -> Clip:
    """The frames of a file, all of them baked to a temporary folder. Raises SceneError."""
    _refuse_duration(path, bake)
    expect_library(path, ".4dgs", "fourdgs")
    data = path.read_bytes()
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "rows"
        words = [str(bake.fps or 0), str(target)]
        seconds = SECONDS + _SECONDS_PER_BYTE * len(data)
        if reason := run_limited("fourdgs", words, _COPIES * len(data), data, seconds=seconds):
            raise SceneError(f"{path}: expected .4dgs, got what fourdgs cannot read: {reason}")
        said = json.loads(target.with_name("rows.json").read_text())
        try:
            clip = clip_of(_frames(target, said), exact_number(said["fps"]))
        except SceneError as error:
            raise SceneError(f"{path}: {error}") from error
    counts = said["counts"]
    numbers = f"{min(counts)} to {max(counts)}" if len(set(counts)) > 1 else f"{counts[0]}"
    rate = f"{float(clip.fps):g} a second"
    return replace(clip, note=f".4dgs, {said['model']}: {numbers} Gaussians in {len(counts)} frames at {rate}")


def _frames(rows: Path, said: dict[str, Any]) -> Iterator[Gaussians]:
    """The frames that the program of `sandbox` left."""
    width = said["width"]
    with rows.open("rb") as file:
        for count in said["counts"]:
            table = np.fromfile(file, "<f4", count * width).reshape(count, width)
            means, quaternions, sizes, alpha, rgb, sh = np.split(table, [3, 7, 10, 11, 14], axis=1)
            dc = (rgb - np.float32(0.5)) / np.float32(SH_C0)
            rest = sh.reshape(count, 3, -1 if width > 14 else 0).transpose(0, 2, 1)
            yield Gaussians(means, quaternions, logs_of(sizes), logits_of(alpha[:, 0]), dc, rest)


def open_splat4d(path: Path, bake: Bake) -> Clip:
    """The frames of a file, each read when it is asked for. Raises SceneError.

    Its beginning: the magic SP4D, a version and the length of a JSON header, 32 bits little-endian each, and the
    header, of which `n` is the number of rows, `t` that of frames. A frame has no SH, its rows are in one order.
    """
    _refuse_duration(path, bake)
    if bake.fps is not None:
        raise SceneError(f"{path}: expected no frame rate to bake at, .splat4d has whole frames, got {bake.fps} fps")
    with expecting(path, "a .splat4d header"):
        cursor = Cursor.open(path)
        magic, version, length = cursor.take("4sII")
        if (magic, version) != (b"SP4D", 1):
            raise ValueError(f"version 1, got {magic!r} of version {version}")
        header = json.loads(cursor.piece(min(length, _MOST_JSON)))
        count, frames, fps = header["n"], header["t"], exact_number(str(header["fps"]))
        whole = isinstance(count, int) and isinstance(frames, int)
        if not whole or min(count, frames) < 1 or not 0 < fps <= MAX_FPS:
            raise ValueError(f"{count} Gaussians, {frames} frames, {fps} fps"[:120])
    frame = check_count(path, FrameHeader(count, 0))
    count_frames(path, fps, frames / fps)
    note = f".splat4d, {count} Gaussians in {frames} frames, {float(fps):g} a second"
    return Clip((frame,) * frames, fps, functools.partial(_read_splat4d, count), note)


def _read_splat4d(count: int, path: Path, frame: int) -> Gaussians:
    """One frame. Raises SceneError."""
    places = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    command = shutil.which("splat4d", path=places)
    if command is None:
        raise SceneError(f"{path}: .splat4d files need splats4d: pip install 'airgs-codec[formats]'")
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "frame.splat"
        words = ["decode", str(path.absolute()), "--frame", str(frame), "-o", str(target)]
        reason = run_limited(command, words, count * _ROW_COPIES * ROW_BYTES)
        if reason or not target.is_file():
            raise SceneError(f"{path}: expected .splat4d, got what splat4d cannot read at frame {frame}: {reason}")
        g = read_splat(target)
    if len(g) != count:
        raise SceneError(f"{path}: expected {count} Gaussians in frame {frame} as its header says, got {len(g)}")
    return g


def _refuse_duration(path: Path, bake: Bake) -> None:
    if bake.seconds is not None:
        raise SceneError(f"{path}: expected no duration, the file states its own, got {float(bake.seconds):g} s")


FOUR_DGS = ClipFormat(name=".4dgs", suffixes=(".4dgs",), open=open_4dgs)
SPLAT4D = ClipFormat(name=".splat4d", suffixes=(".splat4d",), open=open_splat4d)
