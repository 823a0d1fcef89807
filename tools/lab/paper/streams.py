"""Every method's stream over recorded links, frame by frame as the paper streams (its Figures of transmission time).

Frame t is pushed at t / R and should be there at (t + 1) / R; the rate of that moment is known. Frames follow one
another on the link: one that is not through when the next is due delays it. A keyframe is spread evenly over the frames
up to the next keyframe, for every method alike: no link that carries the other frames in 1 / R seconds carries a
keyframe in that time. AirGS has its levels to choose from and V³ three QPs, the others have one size a frame; every
method may skip a frame that does not fit. Of one that is late or skipped the one that stands is seen in its place.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from airgs_codec.decoder.decode import decode_frames
from airgs_codec.media.metrics import mse, psnr
from airgs_codec.package.manifest import Manifest
from airgs_codec.package.package import Package
from airgs_codec.play.ladder import Option, build_ladder, frame_budget, saved_shares, select, select_literal
from airgs_codec.play.study import offsets_of
from airgs_codec.play.trace import Link, Trace
from airgs_codec.render.backend import CPU
from airgs_codec.scene.formats.ply import read_ply
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.trainer.data.pictures import ScenePictures
from tools.lab.baselines.airgs import delta_bytes, fetched_bytes, keyframe_bytes
from tools.lab.baselines.method import Frame, frame_path

SECONDS = 10.0  # that are streamed from each offset, in whole rounds of the sequence
OURS = ("airgs", "airgs-paper")  # methods that have levels to choose from
SHORTEST_S = 1e-9  # no sum of times is more exact
SKIPPED = -1  # in place of a level
NOTHING = -1  # in place of a frame: none has arrived yet

Levels = tuple[Option, ...]  # of one frame, the best one first
Chooser = Callable[[Levels, float], tuple[int, bool]]  # levels, budget in bytes -> level or SKIPPED, whether it fits


def choose_top(levels: Levels, budget: float) -> tuple[int, bool]:
    return levels[0].index, levels[0].size_bytes <= budget


def choose_best(levels: Levels, budget: float) -> tuple[int, bool]:
    """The best level before the cliff, if there is one, that fits, no level if none does."""
    decision = select(build_ladder(levels), budget)
    return (decision.index, True) if decision.fits else (SKIPPED, False)


def choose_literally(levels: Levels, budget: float) -> tuple[int, bool]:
    answer = select_literal(levels, budget)
    chosen = levels[-1 if answer is None else answer]
    return chosen.index, chosen.size_bytes <= budget


SERVER = "paper-server"  # the same choice, by a server that knows what its viewer has
CHOOSERS: dict[str, Chooser] = {
    "unpruned": choose_top, "paper": choose_best, "paper-literal": choose_literally, SERVER: choose_best,
}  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class FrameLog:
    levels: NDArray[np.int64]  # SKIPPED where nothing was sent
    sizes: NDArray[np.float64]  # bytes
    sent_s: NDArray[np.float64]  # from the first bit to the last; 0 for a skipped frame
    waited_s: NDArray[np.float64]  # behind the frames before it
    paper_s: NDArray[np.float64]  # bits over the rate at its moment: the paper's transmission time; inf in an outage
    fits: NDArray[np.bool_]
    fps: float

    @property
    def shown(self) -> NDArray[np.int64]:
        """(n,) the frame that stands on the screen when frame n should: the last one through; NOTHING before any is."""
        due_s = np.arange(len(self.levels)) / self.fps
        sent = np.flatnonzero(self.levels != SKIPPED)
        through_s = (due_s + self.waited_s + self.sent_s)[sent]  # ascends: frames follow one another
        places = np.searchsorted(through_s, due_s + 1 / self.fps + SHORTEST_S, side="right")
        places = np.minimum(places, np.searchsorted(sent, np.arange(len(due_s)), side="right"))  # not one still to come
        return np.concatenate([[NOTHING], sent])[places]


class Source(Protocol):
    """What may be sent of each frame of a sequence that begins anew after `count` frames."""

    count: int

    def levels(self, past: Sequence[int]) -> Levels:
        """The levels of the next frame, after frames that were sent at levels of the `past`, or SKIPPED."""

    def psnr(self, sent: Sequence[int], old: int, due: int) -> float:
        """dB of frame `old` of those sent while frame `due` should be seen, mean over held-out views."""


def push_frames(source: Source, count: int, fps: float, link: Link, choose: Chooser) -> FrameLog:
    """Push frames, one every 1 / fps seconds, in the level that `choose` names; levels are numbered from 0."""
    free_s, pushed, past = 0.0, [], list[int]()
    for n in range(count):
        due_s, levels = n / fps, source.levels(past)
        now = link.trace.rate_at(due_s)
        level, fits = choose(levels, frame_budget(now, fps))
        past.append(level)
        if level == SKIPPED:
            pushed.append((SKIPPED, 0.0, 0.0, 0.0, 0.0, False))
            continue
        size, begin_s = levels[level].size_bytes, max(due_s, free_s)
        free_s = link.arrival_s(size, begin_s)
        paper_s = 8 * size / now if now > 0 else math.inf
        pushed.append((level, float(size), free_s - begin_s, begin_s - due_s, paper_s, fits))
    chosen, sizes, sent, waited, paper, fit = map(np.array, zip(*pushed, strict=True))
    return FrameLog(chosen, sizes, sent, waited, paper, fit, fps)


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    sizes: NDArray[np.float64]  # (T,) bytes
    saved: NDArray[np.float64]  # (T,) share of the bytes of the best level's states that it saves, for the cliff
    psnr: NDArray[np.float64]  # (T, T) dB of frame [i] while [j] should be seen, mean over held-out views


class Stored(Source):
    """Levels that are the same for every viewer."""

    def __init__(self, levels: Sequence[Level]) -> None:
        """`levels`: the best one first."""
        self.of_all, self.count, numbered = levels, len(levels[0].sizes), list(enumerate(levels))
        self._options = [
            tuple(Option(j, round(v.sizes[t]), float(v.psnr[t, t]), float(v.saved[t])) for j, v in numbered)
            for t in range(self.count)
        ]

    def levels(self, past: Sequence[int]) -> Levels:
        return self._options[len(past) % self.count]

    def psnr(self, sent: Sequence[int], old: int, due: int) -> float:
        return float(self.of_all[sent[old]].psnr[old % self.count, due % self.count])


@dataclass(frozen=True, slots=True, eq=False)
class Stream:
    method: str
    chooser: str  # of CHOOSERS
    source: Source

    def table(self, log: FrameLog) -> dict[str, Any]:
        """The figures of a session; shares of frames are 0..1, times ms by bits over the rate of the moment.

        psnr: mean over the frames sent of the dB of their level; psnr_screen: mean over frames of the dB of what stood
        at their moment against the picture that is due. stale: an earlier frame stood; blank: none had come yet. late:
        not through the link when the next was due; skipped: nothing was sent; infeasible: no level fitted; outage:
        pushed while the rate was zero. most_ms, mean and 95 % are of the frames sent outside outages.
        """
        numbers, levels, shown = np.arange(len(log.levels)), log.levels.tolist(), log.shown
        sent = log.levels != SKIPPED
        ms = 1e3 * log.paper_s[sent & np.isfinite(log.paper_s)]
        own = [self.source.psnr(levels, n, n) for n in numbers[sent].tolist()]
        both = zip(shown.tolist(), numbers.tolist(), strict=True)
        seen = [self.source.psnr(levels, old, due) for old, due in both if old != NOTHING]
        return {
            "frames": len(numbers), "kb_frame": float(log.sizes.mean() / 1e3),
            "psnr": float(np.mean(own)) if own else np.nan, "psnr_screen": float(np.mean(seen)) if seen else np.nan,
            "stale": float(((shown != NOTHING) & (shown < numbers)).mean()),
            "blank": float((shown == NOTHING).mean()), "mean_ms": float(ms.mean()) if len(ms) else np.nan,
            "p95_ms": float(np.percentile(ms, 95)) if len(ms) else np.nan,
            "most_ms": float(ms.max()) if len(ms) else np.nan, "link_most_ms": float(1e3 * log.sent_s.max()),
            "outage": float((~np.isfinite(log.paper_s)).mean()),
            "late": float((log.waited_s + log.sent_s > 1 / log.fps + SHORTEST_S).mean()),
            "infeasible": float((~log.fits).mean()), "skipped": float((~sent).mean()),
        }  # fmt: skip


def levels_of(place: Path, frames: Sequence[Frame], pictures: ScenePictures) -> list[Level]:
    """What a rival may send: its frames, and of V³ those of higher QPs, too; it may change QPs at any frame."""
    kinds, levels = [f.kind == "keyframe" for f in frames], list[Level]()
    for one in (place, *sorted(place.glob("qp*"))):
        shown = [read_ply(frame_path(one, n)) for n in range(len(frames))]
        of = [json.loads((one / f"{n}.json").read_text()) if levels else f.bytes for n, f in enumerate(frames)]
        sizes = spread_keyframes(of, kinds)
        levels.append(Level(sizes, 1 - sizes / levels[0].sizes if levels else 0 * sizes, psnr_of_all(shown, pictures)))
    return levels


def spread_keyframes(sizes: Sequence[float], keyframes: Sequence[bool]) -> NDArray[np.float64]:
    """(T,) bytes of the frames, those of each keyframe and what follows it up to the next keyframe being evened out.

    A frame in a group is taken to cost what it does; of a keyframe, what exceeds the mean of the other frames of its
    group is spread over all of them.
    """
    out = np.array(sizes, float)
    starts = [t for t, keyframe in enumerate(keyframes) if keyframe or t == 0]
    for start, stop in zip(starts, [*starts[1:], len(out)], strict=True):
        rest = out[start + 1 : stop]
        if len(rest):
            extra = max(0.0, out[start] - rest.mean())
            out[start] -= extra
            out[start:stop] += extra / (stop - start)
    return out


def airgs_levels(package: Package, pictures: ScenePictures) -> tuple[Level, ...]:
    """The levels of a package with their shares of keyframes and tables, in the finest keyframe quality."""
    m, saved = package.manifest, saved_by_level(package.manifest)
    levels = []
    for j in range(len(m.levels)):
        sizes = keyframe_shares(package, j)
        for index, segment in enumerate(m.segments):
            sizes[segment.start : segment.stop] += delta_bytes(m, index, j)
        shown = [frame.gaussians for frame in decode_frames(package, 0, m.frames, level=j)]
        levels.append(Level(sizes, saved[j], psnr_of_all(shown, pictures)))
    return tuple(levels)


def keyframe_shares(package: Package, level: int) -> NDArray[np.float64]:
    """(T,) bytes of tables and keyframes of a level, spread over the frames that they are for."""
    m = package.manifest
    sizes = np.full(m.frames, (sum(fetched_bytes(package)) - m.bytes_of(m.rung_files(0, 0))) / m.frames)
    for number, group in enumerate(m.groups):
        sizes[group.start : group.stop] += keyframe_bytes(m, number, level) / (group.stop - group.start)
    return sizes


def saved_by_level(m: Manifest) -> NDArray[np.float64]:
    """(L, T) share of the bytes of level 0 that each level saves in each frame's segment, as players count them."""
    saved = np.empty((len(m.levels), m.frames))
    for segment in m.segments:
        saved[:, segment.start : segment.stop] = np.array(saved_shares([v.file.bytes for v in segment.levels]))[:, None]
    return saved


def psnr_of_all(shown: Sequence[Gaussians], pictures: ScenePictures) -> NDArray[np.float64]:
    """(T, T) what `psnr_of` gives for each of T frames."""
    return np.stack([psnr_of(g, pictures, len(shown)) for g in shown])


def psnr_of(shown: Gaussians, pictures: ScenePictures, count: int) -> NDArray[np.float64]:
    """(T,) mean over held-out views of the PSNR, in dB, of a frame against the pictures of each of `count` frames."""
    loaded = CPU.load(shown)
    drawn = [loaded.draw(view.camera).rgb for view in pictures.held_out(0)]
    views = (zip(drawn, pictures.held_out(t), strict=True) for t in range(count))
    return np.array([np.mean([psnr(mse(a, view.target.rgb)) for a, view in pairs]) for pairs in views])


def stream(one: Stream, traces: Sequence[Trace], offsets: int, fps: float) -> dict[str, Any]:
    """A row: means over all runs."""
    count = one.source.count
    count *= max(1, round(SECONDS * fps / count))
    links = [Link.over(trace.cut(at)) for trace in traces for at in offsets_of(trace, offsets, 1)]
    logs = [push_frames(one.source, count, fps, link, CHOOSERS[one.chooser]) for link in links]
    runs: list[Mapping[str, float]] = [one.table(log) for log in logs]
    row = {key: _mean_of([run[key] for run in runs]) for key in runs[0]}
    return {"method": one.method, "chooser": one.chooser, "runs": len(runs)} | row


def _mean_of(values: Sequence[float]) -> float:
    known = [value for value in values if not math.isnan(value)]
    return float(np.mean(known)) if known else math.nan
