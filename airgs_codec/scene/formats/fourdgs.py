"""Avala's .4dgs, version 1: Gaussians on one clock, which `bake_4dgs` bakes to frames with the library fourdgs."""

from __future__ import annotations

import functools
import tempfile
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError
from airgs_codec.scene.formats.axes import Axes
from airgs_codec.scene.formats.clip import Bake, Clip, rate_words, refuse_baking
from airgs_codec.scene.formats.library import check_count, expect_library
from airgs_codec.scene.formats.linear import logits_of, logs_of
from airgs_codec.scene.formats.process import SECONDS, run_limited
from airgs_codec.scene.gaussians import SH_C0, Gaussians
from airgs_codec.scene.ply import PlyHeader

_PROGRAM = Path(__file__).with_name("bake_4dgs.py")
_BLOCK = 16  # frames that are decoded together
_KEPT = 2  # blocks that a process keeps
_COPIES = 128  # of the bytes of a file in the library, at least
_SECONDS_PER_BYTE = 5e-6  # about five times what the library takes
_MAGIC = b"\x894DGS"
_Arrays = dict[str, NDArray]


def open_4dgs(path: Path, bake: Bake) -> Clip:
    """The frames of a file. Raises SceneError."""
    refuse_baking(path, bake, ".4dgs", fps=False)
    found = _run(path, bake.fps or Fraction(0), range(0))
    fps, model = Fraction(str(found["fps"])), str(found["model"])
    counts, degree, stated = found["counts"].tolist(), int(found["degree"]), int(found["stated"])
    known = {count: PlyHeader(count, degree) for count in set(counts)}
    numbers = f"{min(counts)} to {max(counts)}" if len(known) > 1 else f"{counts[0]}"
    note = f".4dgs, {model}: {numbers} Gaussians in {len(counts)} frames at {rate_words(fps)}"
    note += f"; SH of degree {stated} is left out" * (stated > degree)
    for header in known.values():
        check_count(path, header)
    headers = tuple(known[count] for count in counts)
    breaks = tuple(int(frame) for frame in found["breaks"])
    axes = Axes(tuple(found["up"].tolist()), float(found["metres"]) or None) if len(found["up"]) else None
    return Clip(headers, fps, functools.partial(_read, fps, headers), note, breaks, axes)


def _read(fps: Fraction, headers: tuple[PlyHeader, ...], path: Path, frame: int) -> Gaussians:
    """One frame. Raises SceneError."""
    start = frame - frame % _BLOCK
    stop = min(start + _BLOCK, len(headers))
    try:
        block = _block(path, path.stat().st_mtime_ns, fps, start, stop)
    except OSError as error:
        raise SceneError(f"{path}: cannot read: {error.strerror}") from error
    ends = np.cumsum([0, *(header.count for header in headers[start:stop])])
    if ends[-1] != len(block):
        raise SceneError(f"{path}: expected {ends[-1]} Gaussians in frames {start}-{stop - 1}, got {len(block)}")
    return block.take(slice(ends[frame - start], ends[frame - start + 1]))


@functools.lru_cache(maxsize=_KEPT)
def _block(path: Path, _written: int, fps: Fraction, start: int, stop: int) -> Gaussians:
    """Frames [start, stop), one after the other."""
    found = _run(path, fps, range(start, stop))
    dc = (found["rgb"] - np.float32(0.5)) / np.float32(SH_C0)
    sizes, alphas = logs_of(found["scales"]), logits_of(found["alpha"])
    return Gaussians(found["means"], found["quaternions"], sizes, alphas, dc, found["sh"])


def _run(path: Path, fps: Fraction, frames: range) -> _Arrays:
    """What `bake_4dgs` says of a file, and its `frames`. Raises SceneError."""
    expect_library(path, ".4dgs", "fourdgs")
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "frames.npz"
        arguments = [str(path.absolute()), str(target), str(fps), str(frames.start), str(frames.stop)]
        size = _size(path)
        seconds = SECONDS + _SECONDS_PER_BYTE * size
        reason = run_limited(_PROGRAM, arguments, _COPIES * size, seconds=seconds)
        if reason or not target.is_file():
            raise SceneError(f"{path}: expected .4dgs, got what fourdgs cannot read: {reason}")
        with np.load(target) as found:
            return dict(found)


def _size(path: Path) -> int:
    """Bytes of a file that begins as a .4dgs does. Raises SceneError."""
    try:
        with path.open("rb") as file:
            head = file.read(len(_MAGIC))
        if head != _MAGIC:
            raise SceneError(f"{path}: expected a .4dgs file, got {head!r}")
        return path.stat().st_size
    except OSError as error:
        raise SceneError(f"{path}: cannot read: {error.strerror}") from error
