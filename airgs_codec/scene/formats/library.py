"""What libraries read and write for us, each in a process of its own: frames with gaussforge, clips with their own.

Clips are Avala's .4dgs, with fourdgs, and splats4D's .splat4d, with its command.
"""

from __future__ import annotations

import functools
import importlib.util
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
from airgs_codec.scene.formats.ply import read_ply, write_ply
from airgs_codec.scene.formats.sandbox import SECONDS, run_limited
from airgs_codec.scene.formats.splat import ROW_BYTES, read_splat
from airgs_codec.scene.gaussians import SATURATED_LOGIT, SH_C0, Gaussians, logits_of, logs_of

LIBRARY = "gaussforge"
_COPIES = 16  # of a frame in float32, as input, in the library, as .ply
_CLIP_COPIES = 128  # of the bytes of a .4dgs in the library, at least
_SECONDS_PER_BYTE = 5e-6  # of a .4dgs: about five times what the library takes
_ROW_COPIES = 64  # of a row of .splat, in the command
_MOST_JSON = 1 << 24  # bytes


def expect_library(path: Path, form: str, library: str) -> None:
    """Raise SceneError, which says how to install it, when a library that a format needs is not there."""
    if importlib.util.find_spec(library) is None:
        raise SceneError(f"{path}: {form} files need {library}: pip install 'airgs-codec[formats]'")


def read_with_library(path: Path, form: str, data: bytes, header: FrameHeader) -> Gaussians:
    """The Gaussians in the bytes of a file whose header has been read; `form` is the library's name of the format.

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
    """Write one frame of unit quaternions; `form` is the library's name of the format.

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


def open_4dgs(path: Path, bake: Bake) -> Clip:
    """The frames of a file, all of them baked to a temporary folder. Raises SceneError."""
    _refuse_duration(path, bake)
    expect_library(path, ".4dgs", "fourdgs")
    data = path.read_bytes()
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "rows"
        words = [str(bake.fps or 0), str(target)]
        seconds = SECONDS + _SECONDS_PER_BYTE * len(data)
        if reason := run_limited("fourdgs", words, _CLIP_COPIES * len(data), data, seconds=seconds):
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
