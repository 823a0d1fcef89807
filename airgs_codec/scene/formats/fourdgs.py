"""Avala's .4dgs, version 1: Gaussians on one clock, read by `bake_4dgs` and written with the library fourdgs.

N rows of a frame, R records of a file: a Gaussian for as many frames as nothing of it changes.
"""

from __future__ import annotations

import functools
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass, fields
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError
from airgs_codec.scene.files import reading
from airgs_codec.scene.formats.form import (
    Axes,
    Bake,
    Clip,
    ClipFormat,
    FrameHeader,
    Holds,
    check_count,
    rate_words,
    refuse_baking,
)
from airgs_codec.scene.formats.library import expect_library
from airgs_codec.scene.formats.sandbox import SECONDS, run_limited
from airgs_codec.scene.formats.splat import RANGES
from airgs_codec.scene.gaussians import SH_C0, Gaussians, join_rows, logits_of, logs_of

_PROGRAM = Path(__file__).with_name("bake_4dgs.py")
_BLOCK = 16  # frames that are decoded together
_CACHED = 2  # blocks of a process
_COPIES = 128  # of the bytes of a file in the library, at least
_SECONDS_PER_BYTE = 5e-6  # about five times what the library takes
_MAGIC = b"\x894DGS"
_SH_RANGE = 4.0  # of a byte of SH
_Arrays = dict[str, NDArray]


@dataclass(frozen=True, slots=True)
class _Records:
    """R Gaussians and the frames [start, stop) that each is shown in, (R,)."""

    gaussians: Gaussians
    starts: NDArray[np.int64]
    stops: NDArray[np.int64]
    frames: int


def open_4dgs(path: Path, bake: Bake) -> Clip:
    """The frames of a file. Raises SceneError."""
    refuse_baking(path, bake, ".4dgs", fps=False)
    found = _run(path, bake.fps or Fraction(0), range(0))
    fps, model = Fraction(str(found["fps"])), str(found["model"])
    counts, degree, stated = found["counts"].tolist(), int(found["degree"]), int(found["stated"])
    known = {count: FrameHeader(count, degree) for count in set(counts)}
    numbers = f"{min(counts)} to {max(counts)}" if len(known) > 1 else f"{counts[0]}"
    note = f".4dgs, {model}: {numbers} Gaussians in {len(counts)} frames at {rate_words(fps)}"
    note += f"; SH of degree {stated} is left out" * (stated > degree)
    for header in known.values():
        check_count(path, header)
    headers = tuple(known[count] for count in counts)
    breaks = tuple(int(frame) for frame in found["breaks"])
    axes = Axes(tuple(found["up"].tolist()), float(found["metres"]) or None) if len(found["up"]) else None
    return Clip(headers, fps, functools.partial(_read, fps, headers), note, breaks, axes)


def _read(fps: Fraction, headers: tuple[FrameHeader, ...], path: Path, frame: int) -> Gaussians:
    """One frame. Raises SceneError."""
    start = frame - frame % _BLOCK
    stop = min(start + _BLOCK, len(headers))
    with reading(path):
        block = _block(path, path.stat().st_mtime_ns, fps, start, stop)
    ends = np.cumsum([0, *(header.count for header in headers[start:stop])])
    if ends[-1] != len(block):
        raise SceneError(f"{path}: expected {ends[-1]} Gaussians in frames {start}-{stop - 1}, got {len(block)}")
    return block.take(slice(ends[frame - start], ends[frame - start + 1]))


@functools.lru_cache(maxsize=_CACHED)
def _block(path: Path, _written: int, fps: Fraction, start: int, stop: int) -> Gaussians:
    """Frames [start, stop), one after the other."""
    found = _run(path, fps, range(start, stop))
    dc = (found["rgb"] - np.float32(0.5)) / np.float32(SH_C0)
    sizes, alphas = logs_of(found["scales"]), logits_of(found["alpha"])
    return Gaussians(found["means"], found["quaternions"], sizes, alphas, dc, found["sh"])


def _run(path: Path, fps: Fraction, frames: range) -> _Arrays:
    """Run `bake_4dgs`: what it says of a file, and its `frames`. Raises SceneError."""
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
    with reading(path), path.open("rb") as file:
        head = file.read(len(_MAGIC))
        if head != _MAGIC:
            raise SceneError(f"{path}: expected a .4dgs file, got {head!r}")
        return path.stat().st_size


def write_4dgs(path: Path, frames: Iterable[Gaussians], fps: float, _sound: bytes = b"") -> None:
    """Write a .4dgs of the profile `fine`, with Gaussians at rest: what changes is another from then on.

    All records are in memory at once. Raises SceneError when the library is not there or refuses.
    """
    expect_library(path, ".4dgs", "fourdgs")
    import fourdgs

    records = _records(frames)
    g, count = records.gaussians, len(records.gaussians)
    rest = g.sh_rest.transpose(0, 2, 1).reshape(count, -1)
    scene = fourdgs.GaussianSet(
        positions=g.means,
        scales=np.exp(g.log_scales),
        rotations=g.quaternions[:, [1, 2, 3, 0]],
        colors=np.concatenate([g.sh_dc * np.float32(SH_C0) + np.float32(0.5), g.opacities()[:, None]], axis=1),
        motions=np.zeros((count, 3), np.float32),
        mu_t=(records.starts / fps).astype(np.float32),
        sigma_t=np.full(count, np.inf, np.float32),
        win_lo=records.starts / fps,
        win_hi=records.stops / fps,
        sh=np.rint((rest / (2 * _SH_RANGE) + 0.5) * 255).astype(np.uint8) if g.sh_degree else None,
        sh_degree=g.sh_degree,
    )
    try:
        fourdgs.write(str(path), scene, records.frames / fps, options=fourdgs.WriteOptions(profile="fine"))
    except (fourdgs.FourdgsError, ValueError) as error:
        raise SceneError(f"{path}: fourdgs cannot write {count} records: {str(error)[:200]}") from error


def _records(frames: Iterable[Gaussians]) -> _Records:
    """The rows of all frames, those that stay as they are in the frames that follow only once."""
    parts: list[Gaussians] = []
    starts: list[NDArray[np.int64]] = []
    closed: list[tuple[NDArray[np.int64], int]] = []  # records, and the frame that they are not in any more
    owners = np.zeros(0, np.int64)  # (N,) records of the rows of the frame before
    before, total, t = None, 0, -1
    for t, g in enumerate(frames):
        new = ~_same_rows(before, g)
        same_count = before is not None and len(before) == len(g)
        closed.append((owners[new] if same_count else owners, t))
        owners = owners.copy() if same_count else np.zeros(len(g), np.int64)
        owners[new] = total + np.arange(new.sum())
        total += int(new.sum())
        parts.append(g.take(new))
        starts.append(np.full(new.sum(), t))
        before = g
    stops = np.full(total, t + 1)
    for records, stop in closed:
        stops[records] = stop
    return _Records(join_rows(parts), np.concatenate(starts), stops, t + 1)


def _same_rows(a: Gaussians | None, b: Gaussians) -> NDArray[np.bool_]:
    """(N,) which rows of b are in all those of a; none where their numbers differ."""
    if a is None or len(a) != len(b) or a.sh_degree != b.sh_degree:
        return np.zeros(len(b), bool)
    pairs = ((getattr(a, f.name), getattr(b, f.name)) for f in fields(Gaussians))
    return np.logical_and.reduce([(x == y).reshape(len(b), -1).all(axis=1) for x, y in pairs])


FOUR_DGS = ClipFormat(
    name=".4dgs",
    key="4dgs",
    suffixes=(".4dgs",),
    open=open_4dgs,
    write=write_4dgs,
    holds=Holds(
        rounding="positions by 2 % of the median size, sizes by 0.5 %, colours, opacities and SH to 8 bits",
        keeps_rows=False,
        ranges=(*RANGES, ("sh_rest", -_SH_RANGE, _SH_RANGE)),
    ),
    writer="fourdgs",
)
