"""splats4D's .splat4d: one set of Gaussians in all frames, within error bounds; read and written by its own command.

The magic SP4D, a version and the length of a JSON header, 32 bits little-endian each, and the header: the number of
rows `n`, of frames `t`, `fps`, and the groups of frames. The command gives a frame as .splat: no SH, rows in the same
order in every frame.
"""

from __future__ import annotations

import functools
import json
import subprocess
import tempfile
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from airgs_codec.errors import SceneError
from airgs_codec.scene.beside import MAX_FPS, exact_number
from airgs_codec.scene.files import Cursor, expecting
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
from airgs_codec.scene.formats.library import find_command
from airgs_codec.scene.formats.sandbox import run_limited
from airgs_codec.scene.formats.splat import RANGES, ROW_BYTES, read_splat, write_splat
from airgs_codec.scene.gaussians import Gaussians

_MAGIC = b"SP4D"
_VERSION = 1
_MOST_JSON = 1 << 24  # bytes
_ROW_COPIES = 64  # of a row of .splat, in the command
_MOST_SHIFT = 0.05  # of a position, in median sizes


def open_splat4d(path: Path, bake: Bake) -> Clip:
    """The frames of a file, which are there as they are. Raises SceneError."""
    refuse_baking(path, bake, ".splat4d")
    with expecting(path, "a .splat4d header"):
        cursor = Cursor.open(path)
        magic, version, length = cursor.take("4sII")
        if magic != _MAGIC:
            raise SceneError(f"{path}: expected a .splat4d file, got {magic!r}")
        if version != _VERSION:
            raise ValueError(f"expected version {_VERSION}, got {version}")
        header = json.loads(cursor.piece(min(length, _MOST_JSON)))
        count, frames, fps = header["n"], header["t"], exact_number(str(header["fps"]))
        whole = isinstance(count, int) and isinstance(frames, int)
        if not whole or min(count, frames) < 1 or not 0 < fps <= MAX_FPS:
            raise ValueError(f"{count} Gaussians, {frames} frames, {fps} fps"[:120])
        ends = [0] + [end for gop in header["gops"] for end in (gop["f0"], gop["f1"] + 1)]
        if ends[1::2] != ends[:-1:2] or ends[-1] != frames:
            raise ValueError(f"groups that are not frames 0 to {frames - 1}")
    frame = check_count(path, FrameHeader(count, 0))
    count_frames(path, fps, frames / fps)
    note = f".splat4d, {count} Gaussians in {frames} frames, {rate_words(fps)}"
    return Clip((frame,) * frames, fps, functools.partial(_read, count), note)


def _read(count: int, path: Path, frame: int) -> Gaussians:
    """One frame. Raises SceneError."""
    command = _command(path)
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "frame.splat"
        arguments = ["decode", str(path.absolute()), "--frame", str(frame), "-o", str(target)]
        reason = run_limited(command, arguments, count * _ROW_COPIES * ROW_BYTES)
        if reason or not target.is_file():
            raise SceneError(f"{path}: expected .splat4d, got what splat4d cannot read at frame {frame}: {reason}")
        g = read_splat(target)
    if len(g) != count:
        raise SceneError(f"{path}: expected {count} Gaussians in frame {frame} as its header says, got {len(g)}")
    return g


def _command(path: Path) -> str:
    """The command of splats4D, which reads and writes. Raises SceneError where it is not there."""
    if command := find_command("splat4d"):
        return command
    raise SceneError(f"{path}: .splat4d files need splats4d: pip install 'airgs-codec[formats]'")


def write_splat4d(path: Path, frames: Iterable[Gaussians], fps: float, _sound: bytes = b"") -> None:
    """Write a .splat4d; frames of fewer rows than others end in rows of alpha 0.

    The frames lie beside `path` as .splat meanwhile. Raises SceneError when the command is not there or refuses.
    """
    command = _command(path)
    with tempfile.TemporaryDirectory(prefix=".", dir=path.parent) as folder:
        sizes, shift = [], 0.0
        for i, g in enumerate(frames):
            shift = shift or _MOST_SHIFT * float(np.exp(np.median(g.log_scales)))
            write_splat(Path(folder) / f"{i:06d}.splat", g)
            sizes.append(len(g))
        for i, size in enumerate(sizes):
            with (Path(folder) / f"{i:06d}.splat").open("ab") as file:
                file.write(bytes(ROW_BYTES * (max(sizes) - size)))
        options = ["--pos-mm", f"{1000 * shift:.6g}", "--color-levels", "1", "--fps", f"{fps:.9g}"]
        run = [command, "encode", "-i", folder, "-o", str(path.absolute()), *options]
        done = subprocess.run(run, capture_output=True, check=False)
    if done.returncode or not path.is_file():
        reason = next(iter(done.stderr.decode("utf-8", "replace").splitlines()), "it said nothing")
        raise SceneError(f"{path}: splat4d cannot write {len(sizes)} frames: {reason[:200]}")


SPLAT4D = ClipFormat(
    name=".splat4d",
    key="splat4d",
    suffixes=(".splat4d",),
    open=open_splat4d,
    write=write_splat4d,
    holds=Holds(
        sh_degree=0,
        rounding=f"positions by {100 * _MOST_SHIFT:g} % of the median size, sizes by 2 %, "
        "colours and opacity by 1.5 of 255",
        keeps_count=True,
        ranges=RANGES,
    ),
    writer="splat4d",
)
