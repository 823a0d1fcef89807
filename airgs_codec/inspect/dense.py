"""The dense level space of a package: quality and bytes of 0-100 % pruning in 10 % steps, by rendering.

Updates of a share of the moving rows are withheld (`hold`: the rows keep their canonical state) or those rows are not
drawn at all (`drop`). Both send the same bytes: those of the other rows' states, coded here as a level of their own.

The source is the top rung of the package, as decoded. At its own steps that is what a viewer would see; for a step
factor f the states are coded again with steps of sqrt(f^2 - 1), so that both codings together err as one with f would.
Where the original is not given, the top rung's measured error is added. All of this takes errors as independent.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec._report import new_figure, save_figure
from airgs_codec._sampling import middle_frames
from airgs_codec.coding.roundtrip import encode_and_decode
from airgs_codec.decoder.group_states import MEASURED, SHARES, GroupStates, kept_rows, load_states, score_rows
from airgs_codec.errors import ConfigError
from airgs_codec.media.h264 import state_codec
from airgs_codec.media.metrics import mse, psnr, ssim
from airgs_codec.package.store import Package
from airgs_codec.package.tables import Manifest
from airgs_codec.play.ladder import Ladder, Option
from airgs_codec.progress import Progress, silent
from airgs_codec.render import Camera, render
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.sequence import GaussianSequence

FACTORS = (1.0, 1.5, 2.0, 3.0, 4.0)  # of the steps
HOLD, DROP = "hold", "drop"
PRESET = "medium"  # x264's, for bytes as shares of level 0
FRAMES = 3  # measured a segment
PAPER_SAVING, PAPER_COST = 0.42, 2.3  # 1.9 -> 1.1 MB a frame on HiFi4G, and its dB


@dataclass(frozen=True, slots=True)
class DensePoint:
    """One level of one segment, or of all of them together (segment -1)."""

    segment: int
    measure: str  # of MEASURED, what the rows were ranked by
    semantics: str  # hold or drop
    pruned: float
    factor: float
    bytes: int  # of the state segment, without its key
    mse: float
    ssim: float

    @property
    def psnr(self) -> float:
        """dB."""
        return psnr(self.mse)


def measure_dense(
    package: Package,
    cameras: Sequence[Camera],
    training: Sequence[Camera],
    original: GaussianSequence | None = None,
    jobs: int = 1,
    progress: Progress = silent,
) -> list[DensePoint]:
    """Every pruned share for every measure and semantics at the package's steps, and with every factor (`hold`,
    ranked by max x change).

    `cameras` look at the pictures, `training` at usage. Raises ConfigError without measured quality, FormatError.
    """
    m = package.manifest
    if original is None and not all(level.psnr for segment in m.segments for level in segment.levels):
        raise ConfigError("--ladder: the package has no measured quality, give the original with --against")
    points: list[DensePoint] = []
    loaded: dict[int, tuple[GroupStates, dict[str, NDArray[np.float64]]]] = {}
    for index, segment in enumerate(m.segments):
        if segment.group not in loaded:
            states = load_states(package, segment.group)
            loaded = {segment.group: (states, score_rows(states, list(training)))}
        states, scores = loaded[segment.group]
        job = _Job(package, index, states, list(cameras), original)
        plans = [
            *((name, share, 1.0) for name in MEASURED for share in SHARES),
            *((MEASURED[3], share, factor) for factor in FACTORS[1:] for share in SHARES[:-1]),
        ]
        with ThreadPoolExecutor(jobs) as pool:
            kept = [kept_rows(scores[name], share) for name, share, _ in plans]
            tasks = [pool.submit(job.trial, rows, plan[2]) for rows, plan in zip(kept, plans, strict=True)]
            for done, (plan, rows, task) in enumerate(zip(plans, kept, tasks, strict=True)):
                progress(f"segment {index + 1} of {len(m.segments)}", done, len(tasks))
                points += job.measure(*plan, rows, *task.result())
    return points + pool_segments(points, m)


class _Job:
    """One segment: its reference pictures, and what a level makes of it."""

    def __init__(
        self,
        package: Package,
        index: int,
        states: GroupStates,
        cameras: list[Camera],
        original: GaussianSequence | None,
    ) -> None:
        m = package.manifest
        segment = m.segments[index]
        self._index, self._states, self._cameras = index, states, cameras
        self._size = m.bytes_of(m.state_files(index, 0))
        self._values = states.values[segment.start - states.start : segment.stop - states.start]
        numbers = middle_frames(segment.start, segment.stop, FRAMES)
        self._frames = [n - segment.start for n in numbers]
        if original is None:
            frames = [states.show(self._values[t]) for t in self._frames]
            self._floor = 10.0 ** (-segment.levels[0].psnr[0] / 10), 1 - segment.levels[0].ssim[0]
        else:
            frames = original.load(numbers).frames
            self._floor = 0.0, 0.0
        self._pictures = [[render(g, camera).rgb for camera in cameras] for g in frames]
        self._full = max(1, self.code(np.ones(len(states.rows), bool), 1.0)[0])

    def measure(
        self,
        name: str,
        share: float,
        factor: float,
        kept: NDArray[np.bool_],
        coded: int,
        values: list[NDArray[np.float32]],
    ) -> list[DensePoint]:
        """Points of a level of `coded` bytes that decodes to `values` in the measured frames."""
        size = round(self._size * coded / self._full)
        held = [self._states.show(v) for v in values]
        out = [self._point(name, HOLD, share, factor, size, held)]
        if factor == 1:
            out.append(self._point(name, DROP, share, factor, size, [self._states.without(g, ~kept) for g in held]))
        return out

    def _point(
        self, name: str, semantics: str, share: float, factor: float, size: int, frames: list[Gaussians]
    ) -> DensePoint:
        errors, likeness = [], []
        for g, references in zip(frames, self._pictures, strict=True):
            for camera, reference in zip(self._cameras, references, strict=True):
                picture = render(g, camera).rgb
                errors.append(mse(picture, reference))
                likeness.append(ssim(picture, reference))
        squared = float(np.mean(errors)) + self._floor[0]
        return DensePoint(
            self._index, name, semantics, share, factor, size, squared, float(np.mean(likeness)) - self._floor[1]
        )

    def trial(self, kept: NDArray[np.bool_], factor: float) -> tuple[int, list[NDArray[np.float32]]]:
        """Bytes of a level, and the (10 + C, n) that its viewers have in the measured frames."""
        size, _ = self.code(kept, factor)
        if factor == 1:
            return size, [np.where(kept, self._values[t], np.float32(0)) for t in self._frames]
        return size, self.code(kept, math.sqrt(factor**2 - 1))[1]

    def code(self, kept: NDArray[np.bool_], factor: float) -> tuple[int, list[NDArray[np.float32]]]:
        """Bytes of a segment that carries the kept rows, and the (10 + C, n) it decodes to in the measured frames."""
        out = [np.zeros_like(self._values[0]) for _ in self._frames]
        if not kept.any() or not self._size:
            return 0, out
        values = self._values[:, :, kept].astype(np.float64)
        sizes, decoded = encode_and_decode(values, self._states.steps * factor, state_codec(PRESET))
        for held, t in zip(out, self._frames, strict=True):
            held[:, kept] = decoded[t]
        return sum(sizes), out


def pool_segments(points: Sequence[DensePoint], m: Manifest) -> list[DensePoint]:
    """The same levels over all segments: bytes added, errors averaged over frames."""
    weights = [(s.stop - s.start) / m.frames for s in m.segments]

    def name(p: DensePoint) -> tuple[str, str, float, float]:
        return p.measure, p.semantics, p.factor, p.pruned

    pooled = []
    for _, some in itertools.groupby(sorted(points, key=name), name):
        same = list(some)
        first = same[0]
        squared = sum(weights[p.segment] * p.mse for p in same)
        likeness = sum(weights[p.segment] * p.ssim for p in same)
        size = sum(p.bytes for p in same)
        pooled.append(
            DensePoint(-1, first.measure, first.semantics, first.pruned, first.factor, size, squared, likeness)
        )
    return pooled


def pruning_levels(
    points: Sequence[DensePoint], measure: str, semantics: str = HOLD, segment: int = -1
) -> list[DensePoint]:
    """The paper's levels, 0-100 % pruned at the steps of level 0."""
    chosen = [p for p in points if (p.segment, p.measure, p.semantics, p.factor) == (segment, measure, semantics, 1.0)]
    return sorted(chosen, key=lambda p: p.pruned)


def saving_levels(points: Sequence[DensePoint], segment: int = -1) -> list[DensePoint]:
    """The same axis for pairs: for 0, 10 … 90 % of the bytes of level 0 saved, the best pair that saves as much."""
    pairs = [p for p in points if (p.segment, p.measure, p.semantics) == (segment, MEASURED[3], HOLD)]
    full = max(p.bytes for p in pairs)
    levels: list[DensePoint] = []
    for share in SHARES[:-1]:
        saving = [p for p in pairs if p.bytes <= (1 - share) * full + 0.5]
        best = min(saving, key=lambda p: (p.mse, p.bytes))
        if not levels or best != levels[-1]:
            levels.append(best)
    return levels


def cliff(levels: Sequence[DensePoint]) -> tuple[list[DensePoint], list[DensePoint]]:
    """What Algorithm 1's ladder (beta 2) keeps of some levels, and those it leaves out: beaten, or past the cliff.

    The level that sends nothing is in no ladder (`select`, case 14). Drops count per 10 % of the bytes saved.
    """
    coded = [p for p in levels if p.pruned < 1]
    full = max(1, max(p.bytes for p in coded))
    points = [Option(i, p.bytes, p.psnr, 1 - p.bytes / full) for i, p in enumerate(coded)]
    kept = {point.index for point in Ladder.build(points).options}
    return [p for i, p in enumerate(coded) if i in kept], [p for i, p in enumerate(coded) if i not in kept]


def cost_of_saving(levels: Sequence[DensePoint], share: float) -> float:
    """dB lost where `share` of the bytes of the best level are saved, between the levels of their Pareto front."""
    coded = [p for p in levels if p.pruned < 1]
    points = [Option(i, p.bytes, p.psnr, p.pruned) for i, p in enumerate(coded)]
    front = Ladder.build(points, beta=math.inf, cliff_db=math.inf).options[::-1]
    sizes, quality = [p.size_bytes for p in front], [p.quality for p in front]
    return quality[-1] - float(np.interp((1 - share) * sizes[-1], sizes, quality))


def format_dense(points: Sequence[DensePoint], frames: int) -> str:
    """Tables of the pooled level space and the two ladders."""
    lines = ["PSNR in dB (state kB/frame) of the levels, by what rows are ranked by; drop: pruned rows are not drawn"]
    heads = [f"{name}{', drop' * (semantics == DROP)}" for name in MEASURED for semantics in (HOLD, DROP)]
    lines.append("  ".join(["pruned", *(h.rjust(18) for h in heads)]))
    for share in SHARES:
        cells = []
        for name, semantics in itertools.product(MEASURED, (HOLD, DROP)):
            (p,) = (p for p in pruning_levels(points, name, semantics) if p.pruned == share)
            cells.append(f"{p.psnr:.2f} ({p.bytes / frames / 1e3:.2f})".rjust(18))
        lines.append("  ".join([f"{100 * share:4.0f} %", *cells]))
    for title, levels in (
        ("pruning only, by max x change", pruning_levels(points, MEASURED[3])),
        ("pruning only, by hits (the paper's usage frequency)", pruning_levels(points, "hits")),
        ("pairs of pruned share and step factor", saving_levels(points)),
    ):
        kept, _ = cliff(levels)
        top, last = kept[0], kept[-1]
        lines += ["", f"ladder of {title}, beta = 2:"]
        lines += [
            f"  {100 * p.pruned:3.0f} %, x{p.factor:g}  {p.bytes / frames / 1e3:7.2f} kB/frame  {p.psnr:.2f} dB  "
            f"SSIM {p.ssim:.4f}"
            for p in kept
        ]
        saved = 100 * (1 - last.bytes / max(1, top.bytes))
        lines.append(
            f"  the last before the cliff saves {saved:.0f} % of the state for {top.psnr - last.psnr:.2f} dB; "
            f"{100 * PAPER_SAVING:.0f} % cost {cost_of_saving(levels, PAPER_SAVING):.2f} dB (paper: {PAPER_COST} dB)"
        )
    return "\n".join(lines)


def dense_table(points: Sequence[DensePoint]) -> list[dict[str, Any]]:
    """Every point as plain values."""
    names = ("segment", "measure", "semantics", "pruned", "factor", "bytes", "psnr", "ssim")
    return [{name: getattr(p, name) for name in names} for p in points]


def plot_dense(points: Sequence[DensePoint], frames: int, path: Path) -> None:
    """A picture: quality over the pruned share for each measure, and over bytes for the ladders. Raises ConfigError."""
    figure = new_figure(12, 4.8)
    shares, sizes = figure.subplots(1, 2)
    for i, name in enumerate(MEASURED):
        for semantics, line in ((HOLD, "o-"), (DROP, "x:")):
            levels = pruning_levels(points, name, semantics)
            words = f"{name}" if semantics == HOLD else f"{name}, not drawn"
            shares.plot([100 * p.pruned for p in levels], [p.psnr for p in levels], line, color=f"C{i}", label=words)
    shares.set(xlabel="updates pruned, %", ylabel="PSNR, dB", title="Withheld (o) or not drawn (x), by ranking")
    shares.legend(fontsize=8)
    for title, levels, color in (
        ("pruning only, hits", pruning_levels(points, "hits"), "C2"),
        ("pruning only, max x change", pruning_levels(points, MEASURED[3]), "C3"),
        ("share and steps", saving_levels(points), "C4"),
    ):
        kept, left = cliff(levels)
        for some, marker, words in ((kept, "o-", title), (left, "x", "_")):
            x, y = [p.bytes / frames / 1e3 for p in some], [p.psnr for p in some]
            sizes.plot(x, y, marker, color=color, label=words)
        if title == "share and steps":
            for p in kept:
                text = f"{100 * p.pruned:.0f} %, x{p.factor:g}"
                sizes.annotate(text, (p.bytes / frames / 1e3, p.psnr), (5, -9), textcoords="offset points", fontsize=7)
    sizes.set(xlabel="state, kB a frame", ylabel="PSNR, dB", title="Ladders (o) and what the cliff test leaves out (x)")
    sizes.legend(fontsize=8)
    for axis in (shares, sizes):
        axis.grid(alpha=0.3)
    save_figure(figure, path, dpi=110)
