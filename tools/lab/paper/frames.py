"""The paper's streaming, frame by frame: frame t is pushed at t / R and should be there at (t + 1) / R.

`push_frames` pushes any frames of which sizes and qualities are known, such as those of another method, of which each
has one form; `simulate_frames` those of a package. Keys are not part of a package's frames (no link that carries frames
at 1 / R carries a key unit in that time, see `play.ladder`, case 15); with `keys`, every frame also carries its share
of its group's key. Frames follow one another on the link: one that is not through when the next is due delays it. A
frame none of whose levels fits is skipped under `paper` (nothing is sent, the last state stands) and sent at whatever
level Algorithm 1 names under `paper-literal`.

What a viewer sees of a frame that was skipped or comes late is the state before it, and how far that is from the
picture that is due nobody measured for a package: it knows the quality of its levels at their own frames alone. So
`psnr` is the mean over the frames sent and stands beside their share; `psnr_screen` counts every frame by the dB that
what stands had at its own frame, which says too much wherever something moves, unless `held` knows better.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import csr_array

from airgs_codec.errors import ConfigError
from airgs_codec.play.ladder import DEFAULT_BETA, Ladder, Option, saved_shares, select
from airgs_codec.play.offers import Offers
from airgs_codec.play.policies.paper import frame_budget, select_literal
from airgs_codec.play.policies.state import Download, estimate_throughput
from airgs_codec.play.trace import Link

MEMORY = 24  # frames that the throughput estimate looks back on
PROBE_BYTES = 1500
SHORTEST_S = 1e-9  # s; a shorter download would divide by zero, and no sum of times is more exact
SKIPPED = -1  # in place of a level
NOTHING = -1  # in place of a frame: none has arrived yet
PERCENTILES = tuple(range(101))  # of the transmission times: points of their distribution

Levels = tuple[Option, ...]  # of one frame, the best one first
Chooser = Callable[[Levels, float], tuple[int, bool]]  # levels, budget in bytes -> level or SKIPPED, whether it fits
Held = Callable[[int, int], float]  # number of the frame that stands, of the frame that is due -> dB between them


@dataclass(frozen=True, slots=True, eq=False)
class FrameLog:
    """(n,) arrays over the frames of a session."""

    levels: NDArray[np.int64]  # SKIPPED where nothing was sent
    sizes: NDArray[np.float64]  # bytes
    sent_s: NDArray[np.float64]  # from the first bit to the last; 0 for a skipped frame
    waited_s: NDArray[np.float64]  # behind the frames before it
    paper_s: NDArray[np.float64]  # bits over the rate at its moment: the paper's transmission time; inf in an outage
    fits: NDArray[np.bool_]
    quality: NDArray[np.float64]  # dB of the level; NaN where skipped
    fps: float

    @property
    def sent(self) -> NDArray[np.bool_]:
        """(n,) frames of which anything was sent."""
        return self.levels != SKIPPED

    @property
    def late(self) -> NDArray[np.bool_]:
        """(n,) frames that missed 1 / R."""
        return self.waited_s + self.sent_s > 1 / self.fps + SHORTEST_S

    @property
    def shown(self) -> NDArray[np.int64]:
        """(n,) the frame that stands on the screen when frame n should: the last one through; NOTHING before any is."""
        due_s = np.arange(len(self.levels)) / self.fps
        sent = np.flatnonzero(self.sent)
        through_s = (due_s + self.waited_s + self.sent_s)[sent]  # ascends: frames follow one another
        places = np.searchsorted(through_s, due_s + 1 / self.fps + SHORTEST_S, side="right")
        places = np.minimum(places, np.searchsorted(sent, np.arange(len(due_s)), side="right"))  # not one still to come
        return np.concatenate([[NOTHING], sent])[places]


def frame_options(c: Offers, keys: bool) -> list[Levels]:
    """For each frame of the sequence its levels: the bytes of its state picture and its share of the rest of its file.

    With `keys`, its share of its group's keys too.
    """
    frames: list[Levels] = []
    for index, segment in enumerate(c.manifest.segments):
        shared = [_shared_bytes(c, index, j, keys) for j in range(len(segment.levels))]
        saved = saved_shares([level.file.bytes for level in segment.levels])
        for t in range(segment.stop - segment.start):
            sizes = [level.frame_bytes[t] if level.frame_bytes else 0 for level in segment.levels]
            frames.append(
                tuple(
                    Option(j, round(sizes[j] + shared[j]), level.psnr[0] if level.psnr else 0.0, saved[j])
                    for j, level in enumerate(segment.levels)
                )
            )
    return frames


def _shared_bytes(c: Offers, index: int, level: int, keys: bool) -> float:
    """Bytes a frame of what the frames of a segment share: escapes, boxes and, with `keys`, its group's keys."""
    m = c.manifest
    segment = m.segments[index]
    state = segment.levels[level]
    shared = (state.file.bytes - sum(state.frame_bytes)) / (segment.stop - segment.start)
    if keys:
        number = m.group_of(index)
        group = m.groups[number]
        paths = [p for t in range(m.levels[level].tiers) for p in m.key_files(number, t, 0)]
        shared += m.bytes_of(paths) / (group.stop - group.start)
    return shared


def choose_best(levels: Levels, budget: float, beta: float = DEFAULT_BETA) -> tuple[int, bool]:
    """`paper`: the best level before the cliff that fits, no level if none does; without a cliff where beta is inf."""
    ladder = Ladder.build(levels) if beta < math.inf else Ladder.build(levels, beta=beta, cliff_db=math.inf)
    decision = select(ladder, budget)
    return (decision.index, True) if decision.fits else (SKIPPED, False)


def choose_literally(levels: Levels, budget: float, beta: float = DEFAULT_BETA) -> tuple[int, bool]:
    """`paper-literal`: what Algorithm 1 names, the last level where it names none."""
    answer = select_literal(levels, budget, beta)
    chosen = levels[-1 if answer is None else answer]
    return chosen.index, chosen.size_bytes <= budget


def choose_top(levels: Levels, budget: float) -> tuple[int, bool]:
    """`unpruned`: always level 0."""
    return levels[0].index, levels[0].size_bytes <= budget


def choose_smallest(levels: Levels, budget: float) -> tuple[int, bool]:
    """`pruned`: always the smallest level, the paper's full pruning; no frame is skipped."""
    smallest = min(levels, key=lambda p: p.size_bytes)
    return smallest.index, smallest.size_bytes <= budget


CHOOSERS: dict[str, Chooser] = {
    "unpruned": choose_top,
    "paper": choose_best,
    "paper-no-cliff": partial(choose_best, beta=math.inf),
    "paper-literal": choose_literally,
    "paper-literal-no-cliff": partial(choose_literally, beta=math.inf),
    "pruned": choose_smallest,
}


def simulate_frames(
    c: Offers, link: Link, chooser: str, loops: int, keys: bool = False, known: bool = True
) -> FrameLog:
    """Push `loops` rounds of a package's frames, with levels that one of CHOOSERS names; see `push_frames`.

    `keys`: frames carry their share of their group's keys. Raises ConfigError for a package without measured quality
    or an unknown chooser, TransportError as `push_frames`.
    """
    if chooser not in CHOOSERS:
        raise ConfigError(f"frame mode: expected {', '.join(CHOOSERS)}, got {chooser}")
    if not c.manifest.measured:
        raise ConfigError("frame mode: the package has no measured quality, encode it without --measure-pictures 0")
    return push_frames(frame_options(c, keys) * loops, c.fps, link, CHOOSERS[chooser], known)


@dataclass(frozen=True, slots=True)
class _Frame:
    """One entry of every array of a FrameLog."""

    levels: int
    sizes: float
    sent_s: float
    waited_s: float
    paper_s: float
    fits: bool
    quality: float


def push_frames(frames: Sequence[Levels], fps: float, link: Link, choose: Chooser, known: bool = True) -> FrameLog:
    """Push frames, one every 1 / fps seconds, in the level that `choose` names; levels are numbered from 0.

    `known`: B is the true rate at the frame's moment, as in the paper, else estimated from the frames before. A method
    without levels gives one Option a frame, and `choose_top` sends them all. Raises ConfigError unless fps > 0 and
    there are frames, TransportError for a trace that ends too soon, and as `Link.passed_s` for one that is too slow.
    """
    if not frames:
        raise ConfigError("frame mode: expected at least one frame, got none")
    if not fps > 0:
        raise ConfigError(f"frame rate: expected more than 0, got {fps}")
    history: list[Download] = []
    free_s = 0.0
    pushed: list[_Frame] = []
    for n, levels in enumerate(frames):
        due_s = n / fps
        now = link.trace.rate_at(due_s)
        level, fits = choose(levels, frame_budget(now if known else estimate_throughput(history[-MEMORY:]), fps))
        begin_s = max(due_s, free_s)
        if level == SKIPPED:
            pushed.append(_Frame(SKIPPED, 0.0, 0.0, 0.0, 0.0, False, math.nan))
            if not known:  # a packet to measure with: an estimate of zero must be able to recover
                history.append(_download(PROBE_BYTES, begin_s, link.passed_s(PROBE_BYTES, begin_s)))
            continue
        size = levels[level].size_bytes
        free_s = link.passed_s(size, begin_s)
        history.append(_download(size, begin_s, free_s))
        paper_s = 8 * size / now if now > 0 else math.inf
        waited_s, quality = begin_s - due_s, levels[level].quality
        pushed.append(_Frame(level, float(size), free_s - begin_s, waited_s, paper_s, fits, quality))
    columns = {field.name: np.array([getattr(frame, field.name) for frame in pushed]) for field in fields(_Frame)}
    return FrameLog(fps=fps, **columns)


def _download(size: int, begin_s: float, arrival_s: float) -> Download:
    """Return what the throughput estimate sees; a download that rounds to no time still has a rate."""
    return Download(max(1, size), max(arrival_s - begin_s, SHORTEST_S))


def frame_table(log: FrameLog, held: Held | None = None) -> dict[str, Any]:
    """The figures of the paper's table; shares of frames are 0..1, times ms by bits over the rate of the moment.

    kb_frame: state sent. psnr: mean over the frames sent of the dB of their level; psnr_screen: mean over frames of the
    dB of what stood at their moment, `held` giving that of an older state against the picture that is due. stale: an
    earlier frame stood; blank: none had come yet. late: not through the link when the next was due; skipped: nothing
    was sent; infeasible: no level fitted; outage: pushed while the rate was zero. worst_ms, mean and 95 % are of the
    frames sent outside outages. NaN where there are none.
    """
    ms = 1e3 * log.paper_s[log.sent & np.isfinite(log.paper_s)]
    known = log.quality[np.isfinite(log.quality)]
    return {
        "frames": len(log.levels),
        "kb_frame": float(log.sizes.mean() / 1e3),
        "psnr": float(known.mean()) if len(known) else np.nan,
        **_screen(log, held),
        "mean_ms": float(ms.mean()) if len(ms) else np.nan,
        "p95_ms": float(np.percentile(ms, 95)) if len(ms) else np.nan,
        "worst_ms": float(ms.max()) if len(ms) else np.nan,
        "link_worst_ms": float(1e3 * log.sent_s.max()),
        "outage": float((~np.isfinite(log.paper_s)).mean()),
        "late": float(log.late.mean()),
        "infeasible": float((~log.fits).mean()),
        "skipped": float((~log.sent).mean()),
    }


def _screen(log: FrameLog, held: Held | None) -> dict[str, float]:
    """The dB of what stands, over the frames at which anything does; shares of frames that show an older one, none."""
    shown, numbers = log.shown, np.arange(len(log.levels))
    old, blank = (shown != NOTHING) & (shown < numbers), shown == NOTHING
    quality = log.quality[shown]
    if held is not None:
        quality[old] = [held(int(shown[n]), int(n)) for n in numbers[old]]
    quality = quality[~blank]
    mean = float(quality.mean()) if len(quality) else np.nan
    return {"psnr_screen": mean, "stale": float(old.mean()), "blank": float(blank.mean())}


def time_percentiles(logs: Sequence[FrameLog]) -> list[float]:
    """(101,) percentiles of the paper's times in ms over all frames of some sessions.

    A frame that was skipped, or pushed while nothing passed, never came: it counts as infinite.
    """
    times = np.concatenate([np.where(log.sent, log.paper_s, np.inf) for log in logs])
    return [float(v) for v in 1e3 * np.percentile(times, PERCENTILES, method="inverted_cdf")]


def paper_programme(
    sizes: ArrayLike, qualities: ArrayLike, budgets: ArrayLike, integer: bool = True
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """The paper's integer programme (eq. 13) over n frames of L levels, or its linear relaxation, solved with HiGHS.

    sizes (n, L) in bytes, qualities (n, L) in dB, budgets (n,) in bytes. Gives (n, L) the share of each level, zeros
    where none fits, and (n,) where one does: elsewhere the programme as printed has no solution.
    """
    size, quality = np.asarray(sizes, np.float64), np.asarray(qualities, np.float64)
    budget = np.asarray(budgets, np.float64)
    feasible: NDArray[np.bool_] = np.any(size <= budget[:, None], axis=1)
    shares = np.zeros(size.shape)
    n, levels = int(feasible.sum()), size.shape[1]
    if n:
        of_frame = (np.repeat(np.arange(n), levels), np.arange(n * levels))
        one = csr_array((np.ones(n * levels), of_frame), shape=(n, n * levels))
        spent = csr_array((size[feasible].ravel(), of_frame), shape=(n, n * levels))
        result = milp(
            -quality[feasible].ravel(),
            constraints=[LinearConstraint(one, 1, 1), LinearConstraint(spent, -np.inf, budget[feasible])],
            bounds=Bounds(0.0, 1.0),
            integrality=np.full(n * levels, int(integer)),
        )
        shares[feasible] = result.x.reshape(n, levels)
    return shares, feasible


def frame_programme(frames: Sequence[Levels], fps: float, link: Link) -> dict[str, float]:
    """The paper's integer programme over frames pushed at `fps`, with the true rate of each moment as B.

    It separates by frame, so that the best level that fits each frame is as good. Frames of which no level fits are
    left out (`infeasible`). `psnr` is the mean dB over the others, NaN without any; `solve_s` the seconds of the
    solver.
    """
    budgets = [frame_budget(link.trace.rate_at(n / fps), fps) for n in range(len(frames))]
    sizes = [[level.size_bytes for level in levels] for levels in frames]
    qualities = np.array([[level.quality for level in levels] for levels in frames])
    began_s = time.perf_counter()
    shares, feasible = paper_programme(sizes, qualities, budgets)
    solve_s = time.perf_counter() - began_s
    count = int(feasible.sum())
    return {
        "psnr": float((shares * qualities).sum() / count) if count else np.nan,
        "infeasible": 1 - count / len(frames),
        "solve_s": solve_s,
    }
