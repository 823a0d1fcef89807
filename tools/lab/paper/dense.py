"""The dense level space of a package: quality and bytes of 0-100 % pruning in 10 % steps, by rendering; and the
ladders of Algorithm 1 on it.

The updates of a share of the moving rows are withheld (`hold`: those rows keep their canonical state) or those rows
are not drawn at all (`drop`). Both send the same bytes: those of the other rows' states, coded here as a level of
their own.

The source is the top rung of the package, as decoded. At its own steps that is what a viewer would see; for a step
factor f the states are coded again with steps of sqrt(f^2 - 1), so that both codings together err as one with f would.
All of this takes errors as independent.

PSNR is that of the squared error pooled over views and frames, as in the package's tables. n moving rows of a group,
T frames of a segment, C colour channels beside the ten of position, rotation, scale and opacity.
"""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec._sampling import middle_frames
from airgs_codec.encoder.sample import encode_and_decode
from airgs_codec.errors import ConfigError
from airgs_codec.media.h264 import state_codec
from airgs_codec.media.metrics import psnr
from airgs_codec.package.manifest import Manifest
from airgs_codec.package.package import Package, open_package
from airgs_codec.play.ladder import Ladder, Option
from airgs_codec.progress import Progress, silent
from airgs_codec.render import Camera, read_cameras
from airgs_codec.render.compare import Source, View, compare, draw_frames, draw_once, in_order
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.sequence import GaussianSequence, open_sequence
from tools.lab import Lab, Page, Picture, Section, Table, content, required, setting
from tools.lab.paper.states import MEASURED, SHARES, GroupStates, checking_views, kept_rows, load_states, score_rows

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FACTORS = (1.0, 1.5, 2.0, 3.0, 4.0)  # of the steps
HOLD, DROP = "hold", "drop"
BEST_RANKING = MEASURED[3]  # what rows are ranked by where steps change too
PRESET = "medium"  # x264's, for bytes as shares of level 0
FRAMES = 3  # measured in a segment
WHOLE = -1  # in place of a segment: all of them together

Values = NDArray[np.float32]  # (10 + C, n) differences of a frame to the canonical space


@dataclass(frozen=True, slots=True)
class Pruning:
    """What a level sends: the rows that rank highest, in steps of a factor."""

    ranking: str  # of MEASURED, what rows are ranked by
    pruned: float  # share of the moving rows that is withheld, 0..1
    factor: float  # of level 0's steps


@dataclass(frozen=True, slots=True)
class DenseLevel:
    """One level of one segment, or of all segments together (segment WHOLE)."""

    segment: int
    pruning: Pruning
    semantics: str  # of the rows withheld: HOLD or DROP
    bytes: int  # of the state segment, without its key
    mse: float  # pooled over views and frames, for a range of 1
    ssim: float  # mean over views and frames

    @property
    def psnr(self) -> float:
        """dB, of the pooled squared error."""
        return psnr(self.mse)


def measure_dense(
    package: Package,
    cameras: Sequence[Camera],
    training: Sequence[Camera],
    original: GaussianSequence,
    jobs: int = 1,
    progress: Progress = silent,
) -> list[DenseLevel]:
    """Levels of every segment and of all together.

    Every pruned share for every ranking at the package's steps, in both semantics, and with every factor (`hold`,
    ranked by BEST_RANKING). `cameras` see the pictures that are compared, `training` those in which usage is
    measured. `jobs` levels are coded at a time. Raises FormatError.
    """
    m = package.manifest
    prunings = [
        *(Pruning(ranking, share, 1.0) for ranking in MEASURED for share in SHARES),
        *(Pruning(BEST_RANKING, share, factor) for factor in FACTORS[1:] for share in SHARES[:-1]),
    ]
    levels: list[DenseLevel] = []
    loaded: dict[int, tuple[GroupStates, dict[str, NDArray[np.float64]]]] = {}
    for index in range(len(m.segments)):
        group = m.group_of(index)
        if group not in loaded:
            states = load_states(package, group)
            loaded = {group: (states, score_rows(states, list(training)))}
        states, scores = loaded[group]
        source = _open_segment(package, index, states, original)
        views = [(t, camera) for t in source.frames for camera in cameras]
        reference = draw_once(draw_frames(in_order(source.frames, iter(source.reference))))
        kept = [kept_rows(scores[pruning.ranking], pruning.pruned) for pruning in prunings]
        with ThreadPoolExecutor(jobs) as pool:
            tasks = [pool.submit(_send, source, rows, p.factor) for rows, p in zip(kept, prunings, strict=True)]
            for done, (pruning, rows, task) in enumerate(zip(prunings, kept, tasks, strict=True)):
                progress(f"segment {index + 1} of {len(m.segments)}", done, len(tasks))
                size, values = task.result()
                for semantics, frames in _shown(source, pruning, rows, values):
                    seen = _compare(in_order(source.frames, iter(frames)), reference, views)
                    levels.append(DenseLevel(index, pruning, semantics, size, *seen))
    return levels + pool_segments(levels, m)


@dataclass(frozen=True, slots=True, eq=False)
class _Segment:
    """A segment of the top rung, decoded, and what its levels are compared with."""

    states: GroupStates  # of its group
    values: NDArray[np.float32]  # (T, 10 + C, n) differences to the canonical space
    frames: tuple[int, ...]  # of the segment, which are measured
    reference: tuple[Gaussians, ...]  # those frames, as they should look
    state_bytes: int  # of level 0 in the package
    coded_bytes: int  # of level 0 as coded here, at least 1


def _open_segment(package: Package, index: int, states: GroupStates, original: GaussianSequence) -> _Segment:
    m = package.manifest
    segment = m.segments[index]
    values = states.values[segment.start - states.start : segment.stop - states.start]
    numbers = middle_frames(segment.start, segment.stop, FRAMES)
    frames = tuple(n - segment.start for n in numbers)
    reference = tuple(original.load(numbers).frames)
    coded, _ = _code(states, values, frames, np.ones(len(states.rows), bool), 1.0)
    return _Segment(states, values, frames, reference, m.bytes_of(m.state_files(index, 0)), max(1, coded))


def _send(source: _Segment, kept: NDArray[np.bool_], factor: float) -> tuple[int, list[Values]]:
    """Bytes of a level, and the values that its viewers have in the measured frames."""
    if not source.state_bytes:
        return 0, [np.zeros_like(source.values[0]) for _ in source.frames]
    coded, _ = _code(source.states, source.values, source.frames, kept, factor)
    size = round(source.state_bytes * coded / source.coded_bytes)
    if factor == 1:
        return size, [np.where(kept, source.values[t], np.float32(0)) for t in source.frames]
    added = math.sqrt(factor**2 - 1)  # steps whose error, added to that of the package's own, is that of the factor
    return size, _code(source.states, source.values, source.frames, kept, added)[1]


def _code(
    states: GroupStates, values: NDArray[np.float32], frames: Sequence[int], kept: NDArray[np.bool_], factor: float
) -> tuple[int, list[Values]]:
    """Bytes of a segment that carries the (n,) kept rows, and the values that some of its frames decode to."""
    decoded = [np.zeros_like(values[0]) for _ in frames]
    if not kept.any():
        return 0, decoded
    sent = values[:, :, kept].astype(np.float64)
    sizes, received = encode_and_decode(sent, states.steps * factor, state_codec(PRESET))
    for frame, t in zip(decoded, frames, strict=True):
        frame[:, kept] = received[t]
    return sum(sizes), decoded


def _shown(
    source: _Segment, pruning: Pruning, kept: NDArray[np.bool_], values: Sequence[Values]
) -> list[tuple[str, list[Gaussians]]]:
    """(semantics, measured frames): withheld rows hold their state, and at the package's own steps also not drawn."""
    held = [source.states.show(v) for v in values]
    if pruning.factor != 1:
        return [(HOLD, held)]
    return [(HOLD, held), (DROP, [source.states.without(g, ~kept) for g in held])]


def _compare(read: Callable[[int], Gaussians], reference: Source, views: Sequence[View]) -> tuple[float, float]:
    """(mean squared error, mean SSIM) over views."""
    found = compare(reference, draw_frames(read), views, lambda wanted, shown: (wanted.mse(shown), wanted.ssim(shown)))
    errors, likeness = zip(*found, strict=True)
    return float(np.mean(errors)), float(np.mean(likeness))


def pool_segments(levels: Sequence[DenseLevel], m: Manifest) -> list[DenseLevel]:
    """The same levels over all segments: bytes added, errors averaged over frames."""
    weights = [(s.stop - s.start) / m.frames for s in m.segments]

    def name(level: DenseLevel) -> tuple[str, float, float, str]:
        return level.pruning.ranking, level.pruning.factor, level.pruning.pruned, level.semantics

    pooled = []
    for _, some in itertools.groupby(sorted(levels, key=name), name):
        same = list(some)
        squared = sum(weights[level.segment] * level.mse for level in same)
        likeness = sum(weights[level.segment] * level.ssim for level in same)
        size = sum(level.bytes for level in same)
        pooled.append(replace(same[0], segment=WHOLE, bytes=size, mse=squared, ssim=likeness))
    return pooled


def pruning_levels(levels: Sequence[DenseLevel], ranking: str, semantics: str = HOLD) -> list[DenseLevel]:
    """The paper's levels over the whole package, 0-100 % pruned at the steps of level 0."""
    return sorted(
        (
            level
            for level in levels
            if (level.segment, level.semantics) == (WHOLE, semantics)
            and (level.pruning.ranking, level.pruning.factor) == (ranking, 1.0)
        ),
        key=lambda level: level.pruning.pruned,
    )


def saving_levels(levels: Sequence[DenseLevel]) -> list[DenseLevel]:
    """For 0, 10 … 90 % of the bytes of level 0 saved, the best pair of pruned share and factor that saves as much."""
    pairs = [
        level
        for level in levels
        if (level.segment, level.semantics, level.pruning.ranking) == (WHOLE, HOLD, BEST_RANKING)
    ]
    full = max(pair.bytes for pair in pairs)
    chosen: list[DenseLevel] = []
    for share in SHARES[:-1]:
        saving = [pair for pair in pairs if pair.bytes <= (1 - share) * full + 0.5]
        best = min(saving, key=lambda pair: (pair.mse, pair.bytes))
        if not chosen or best != chosen[-1]:
            chosen.append(best)
    return chosen


def split_at_cliff(levels: Sequence[DenseLevel]) -> tuple[list[DenseLevel], list[DenseLevel]]:
    """What Algorithm 1's ladder (beta 2) keeps of some levels, and those it leaves out: beaten, or past the cliff.

    The level that sends nothing is in no ladder (see `play.ladder`, case 14). Drops count per 10 % of the bytes saved.
    """
    coded = [level for level in levels if level.pruning.pruned < 1]
    full = max(1, max(level.bytes for level in coded))
    options = [Option(i, level.bytes, level.psnr, 1 - level.bytes / full) for i, level in enumerate(coded)]
    kept = {option.index for option in Ladder.build(options).options}
    return [v for i, v in enumerate(coded) if i in kept], [v for i, v in enumerate(coded) if i not in kept]


def cost_of_saving(levels: Sequence[DenseLevel], share: float) -> float:
    """dB lost where `share` of the bytes of the best level are saved, between the levels of their Pareto front."""
    coded = [level for level in levels if level.pruning.pruned < 1]
    options = [Option(i, level.bytes, level.psnr, saved=0.0) for i, level in enumerate(coded)]  # no cliff is looked for
    front = Ladder.build(options, beta=math.inf, cliff_db=math.inf).options[::-1]
    sizes, quality = [option.size_bytes for option in front], [option.quality for option in front]
    return quality[-1] - float(np.interp((1 - share) * sizes[-1], sizes, quality))


PAPER_SAVING, PAPER_COST = 0.42, 2.3  # 1.9 -> 1.1 MB a frame on HiFi4G, and its dB
PRUNED = {
    "ranking": ("ranked by", ""), "pruned": ("pruned", ".0%"), "kb_frame": ("state kB a frame", ".2f"),
    "psnr_held": ("withheld, dB", ".2f"), "psnr_dropped": ("not drawn, dB", ".2f"),
}  # fmt: skip
LADDERS = {
    "ladder": ("ladder", ""), "level": ("level", ""), "kb_frame": ("state kB a frame", ".2f"), "psnr": ("dB", ".2f"),
    "ssim": ("SSIM", ".4f"), "before_cliff": ("before the cliff", ""),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Options:
    package: Path = required("folder of a package")
    against: Path = setting(Path("tests/data/fox"), "the original sequence")
    views: Path | None = setting(None, "cameras, in place of those of the original or of views drawn")


def run(options: Options, lab: Lab) -> Page:
    package = open_package(options.package)
    frames = package.manifest.frames
    original = open_sequence(options.against)
    if len(original) != frames:
        raise ConfigError(f"{options.against}: expected {frames} frames, got {len(original)}")
    cameras = read_cameras(options.views) if options.views else list(original.cameras)
    training, measured = checking_views(package.manifest.region, cameras)
    reads = {"package": content(options.package), "against": options.against, "views": options.views}
    jobs = os.cpu_count() or 1
    make = lambda: measure_dense(package, measured, training, original, jobs, lab.progress)  # noqa: E731
    levels = lab.results.once("dense", reads, make)
    return page(levels, frames)


def page(levels: Sequence[DenseLevel], frames: int) -> Page:
    pruned = Table("pruned", list(_pruned_rows(levels, frames)), PRUNED)
    ladders = {title: list(_ladder_rows(title, some, frames)) for title, some in _ladders(levels).items()}
    rows = [row for some in ladders.values() for row in some]
    answers = [_answer(title, some) for title, some in _ladders(levels).items()]
    draw = partial(_draw, levels, pruned.rows, rows)
    picture = Picture("dense", "Quality by pruned share and by bytes of the state", draw, (12, 4.8))
    return Page(
        [
            Section(
                " ".join(answers), "What does pruning updates cost, and which levels does Algorithm 1 keep?", [picture]
            )
        ],
        "PSNR is that of the squared error pooled over views and frames.",
        data=[pruned, Table("ladders", rows, LADDERS)],
        more={"levels": [_plain(level) for level in levels]},
    )


def _pruned_rows(levels: Sequence[DenseLevel], frames: int) -> Any:
    for ranking in MEASURED:
        held, dropped = (pruning_levels(levels, ranking, semantics) for semantics in (HOLD, DROP))
        for a, b in zip(held, dropped, strict=True):
            place = {"ranking": ranking, "pruned": a.pruning.pruned, "kb_frame": a.bytes / frames / 1e3}
            yield place | {"psnr_held": a.psnr, "psnr_dropped": b.psnr}


def _ladders(levels: Sequence[DenseLevel]) -> dict[str, list[DenseLevel]]:
    return {
        f"pruning alone, by {BEST_RANKING}": pruning_levels(levels, BEST_RANKING),
        "pruning alone, by hits (the paper's)": pruning_levels(levels, "hits"),
        "pairs of pruned share and step": saving_levels(levels),
    }


def _ladder_rows(title: str, levels: Sequence[DenseLevel], frames: int) -> Any:
    for part, before in zip(split_at_cliff(levels), (True, False), strict=True):
        for level in part:
            name = f"{100 * level.pruning.pruned:.0f} %, x{level.pruning.factor:g}"
            place = {"ladder": title, "level": name, "kb_frame": level.bytes / frames / 1e3}
            yield place | {"psnr": level.psnr, "ssim": level.ssim, "before_cliff": before}


def _answer(title: str, levels: Sequence[DenseLevel]) -> str:
    kept, _ = split_at_cliff(levels)
    top, last = kept[0], kept[-1]
    saved = 100 * (1 - last.bytes / max(1, top.bytes))
    return (
        f"{title[0].upper()}{title[1:]}: the last level before the cliff saves {saved:.0f} % of the state for "
        f"{top.psnr - last.psnr:.2f} dB; {100 * PAPER_SAVING:.0f} % cost {cost_of_saving(levels, PAPER_SAVING):.2f} dB "
        f"(the paper: {PAPER_COST} dB)."
    )


def _plain(level: DenseLevel) -> dict[str, Any]:
    place = {"segment": level.segment, "ranking": level.pruning.ranking, "semantics": level.semantics}
    place |= {"pruned": level.pruning.pruned, "factor": level.pruning.factor}
    return place | {"bytes": level.bytes, "psnr_pooled": level.psnr, "ssim": level.ssim}


def _draw(levels: Sequence[DenseLevel], pruned: Any, ladders: Any, figure: Figure) -> None:
    """Quality over the pruned share for each ranking, and over bytes for the ladders."""
    shares, sizes = figure.subplots(1, 2)
    for i, ranking in enumerate(MEASURED):
        some = [row for row in pruned if row["ranking"] == ranking]
        x = [100 * row["pruned"] for row in some]
        shares.plot(x, [row["psnr_held"] for row in some], "o-", color=f"C{i}", label=ranking)
        shares.plot(x, [row["psnr_dropped"] for row in some], "x:", color=f"C{i}", label=f"{ranking}, not drawn")
    shares.set(xlabel="updates pruned, %", ylabel="PSNR of the pooled error, dB", title="Withheld (o) or not drawn (x)")
    for i, title in enumerate(dict.fromkeys(row["ladder"] for row in ladders)):
        for before, marker, label in ((True, "o-", title), (False, "x", "_")):
            some = [row for row in ladders if (row["ladder"], row["before_cliff"]) == (title, before)]
            x, y = [row["kb_frame"] for row in some], [row["psnr"] for row in some]
            sizes.plot(x, y, marker, color=f"C{4 + i}", label=label)
    sizes.set(xlabel="state, kB a frame", ylabel="PSNR of the pooled error, dB", title="Ladders (o), left out (x)")
    shares.legend(loc="lower left")
    sizes.legend(loc="lower right")
