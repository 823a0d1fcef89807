"""Frames to one file that holds them all: .4dgs by fourdgs, .splat4d by the command of splats4D.

N rows of a frame, R records of a .4dgs: a Gaussian for as many frames as nothing of it changes.
"""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError
from airgs_codec.scene.formats.axes import Axes
from airgs_codec.scene.formats.holds import Holds
from airgs_codec.scene.formats.library import expect_library, find_command
from airgs_codec.scene.formats.splat import ROW_BYTES, SPLAT, write_splat
from airgs_codec.scene.gaussians import SH_C0, Gaussians

Frames = Iterable[Gaussians]
_SH_RANGE = 4.0  # of a byte of SH in .4dgs
_MOST_SHIFT = 0.05  # of a position in .splat4d, in median sizes


@dataclass(frozen=True, slots=True)
class ClipWriter:
    """What writes a format of files that hold many frames each; raises SceneError."""

    name: str
    key: str  # in options; written files end in it, after a dot
    write: Callable[[Path, Frames, float], None]  # of frames as `holds` makes them fit, so many a second
    holds: Holds
    writer: str  # the library or command that `write` needs
    axes: Axes | None = None  # which way is up in its files, where its specification says it


@dataclass(frozen=True, slots=True)
class _Records:
    """R Gaussians and the frames [start, stop) that each is shown in, (R,)."""

    gaussians: Gaussians
    starts: NDArray[np.int64]
    stops: NDArray[np.int64]
    frames: int


def write_4dgs(path: Path, frames: Frames, fps: float) -> None:
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


def _records(frames: Frames) -> _Records:
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
    columns = (np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Gaussians))
    return _Records(Gaussians(*columns), np.concatenate(starts), stops, t + 1)


def _same_rows(a: Gaussians | None, b: Gaussians) -> NDArray[np.bool_]:
    """(N,) which rows of b are in all those of a; none where their numbers differ."""
    if a is None or len(a) != len(b) or a.sh_degree != b.sh_degree:
        return np.zeros(len(b), bool)
    pairs = ((getattr(a, f.name), getattr(b, f.name)) for f in fields(Gaussians))
    return np.logical_and.reduce([(x == y).reshape(len(b), -1).all(axis=1) for x, y in pairs])


def write_splat4d(path: Path, frames: Frames, fps: float) -> None:
    """Write a .splat4d; frames of fewer rows than others end in rows of alpha 0.

    The frames lie beside `path` as .splat meanwhile. Raises SceneError when the command is not there or refuses.
    """
    command = find_command("splat4d")
    if command is None:
        raise SceneError(f"{path}: .splat4d files need splats4d: pip install 'airgs-codec[formats]'")
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


FOUR_DGS = ClipWriter(
    ".4dgs",
    "4dgs",
    write_4dgs,
    Holds(
        rounding="positions by 2 % of the median size, sizes by 0.5 %, colours, opacities and SH to 8 bits",
        keeps_rows=False,
        ranges=(*SPLAT.ranges, ("sh_rest", -_SH_RANGE, _SH_RANGE)),
    ),
    "fourdgs",
)
SPLAT4D = ClipWriter(
    ".splat4d",
    "splat4d",
    write_splat4d,
    Holds(
        sh_degree=0,
        rounding=f"positions by {100 * _MOST_SHIFT:g} % of the median size, sizes by 2 %, "
        "colours and opacity by 1.5 of 255",
        keeps_count=True,
        ranges=SPLAT.ranges,
    ),
    "splat4d",
)
CLIP_WRITERS = (FOUR_DGS, SPLAT4D)
