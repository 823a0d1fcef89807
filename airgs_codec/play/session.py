"""A viewer over a link: requests, arrivals, choices, stalls. Event-driven, deterministic, no clock.

One batch is on the way at a time: a state segment, and before it in the same batch those key units of its group that
its level needs and that are not at hand, in tier order. Where the group begins, key quality and level are chosen
together; the quality then stays. The sequence
may be played `loops` times, as if it were longer: keys and states are fetched again, init segments and manifests are
not. Times are seconds from the first request.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from airgs_codec.errors import ConfigError
from airgs_codec.manifest import Manifest
from airgs_codec.play.link import Link
from airgs_codec.play.policy import Download, PlayerState, budget_bytes, choose_fixed, choose_paper, estimate_throughput
from airgs_codec.play.select import Decision, Point

SHORTEST_S = 1e-9  # a download that rounds to no time still has a rate
SESSION_S = 30.0  # what `loops` aims at when it is not given


@dataclass(frozen=True, slots=True)
class SessionSettings:
    """Rules of the player."""

    policy: str = "paper"  # "paper" or "fixed"
    fixed_level: int = 0
    buffer_s: float = 10.0  # most media time ahead of the playhead
    decode_frame_s: float = 0.004  # time to decode and apply a frame
    loops: int | None = None  # default: about SESSION_S of play


@dataclass(frozen=True, slots=True)
class Fetch:
    """One batch on the wire."""

    kind: str  # manifests, group (key units and state), state
    segment: int  # position in the session, counted over loops
    bytes: int
    request_s: float
    arrival_s: float
    budget_bytes: float
    throughput_bps: float  # the estimate at the request
    reason: str


@dataclass(frozen=True, slots=True)
class Shown:
    """One segment on the screen."""

    segment: int  # in the manifest
    loop: int
    quality: int  # key quality
    level: int
    ready_s: float
    start_s: float  # of its display
    frames: int
    stall_s: float  # waited for before it
    psnr: float | None


@dataclass(frozen=True, slots=True, eq=False)
class SessionLog:
    """Everything that happened; metrics are derived from it."""

    manifest: Manifest
    link: Link
    settings: SessionSettings
    fetches: tuple[Fetch, ...]
    shown: tuple[Shown, ...]
    bytes_by_kind: dict[str, int]


@dataclass(slots=True, eq=False)
class _Player:
    manifest: Manifest
    link: Link
    settings: SessionSettings
    now_s: float = 0.0
    history: list[Download] = field(default_factory=list)
    fetches: list[Fetch] = field(default_factory=list)
    shown: list[Shown] = field(default_factory=list)
    fetched_once: set[str] = field(default_factory=set)
    bytes_by_kind: Counter[str] = field(default_factory=Counter)

    def end_s(self) -> float:
        """When what is at hand will have been shown; now, before anything is."""
        if not self.shown:
            return self.now_s
        last = self.shown[-1]
        return last.start_s + last.frames / float(self.manifest.fps)

    def fetch(self, kind: str, position: int, sizes: list[int], decision: Decision, budget: float) -> None:
        """Request a batch now and wait for it."""
        wire = self.link.wire_bytes(sizes)
        arrival = self.link.arrival_s(sizes, self.now_s)
        estimate = estimate_throughput(self.history)
        self.fetches.append(Fetch(kind, position, wire, self.now_s, arrival, budget, estimate, decision.reason))
        seconds = max(arrival - self.now_s - self.link.rtt_s, SHORTEST_S)
        self.history.append(Download(wire, seconds))
        self.now_s = arrival

    def count(self, kind: str, size: int) -> None:
        """Book payload bytes."""
        self.bytes_by_kind[kind] += size


def simulate(manifest: Manifest, manifest_bytes: int, link: Link, settings: SessionSettings) -> SessionLog:
    """Play the package once over the link. Raises ConfigError for settings that cannot work."""
    m = manifest
    _check(m, link, settings)
    player = _Player(m, link, settings)
    player.fetch("manifests", 0, [manifest_bytes], Decision(0, True, "start", manifest_bytes), 0.0)
    player.count("manifests", manifest_bytes)
    duration = float(m.frames / m.fps)
    loops = settings.loops or max(1, round(SESSION_S / duration))
    quality, tiers, group = 0, 0, (-1, -1)
    for position, (loop, index) in enumerate(_positions(m, loops)):
        segment = m.segments[index]
        _wait_for_room(player, float((segment.stop - segment.start) / m.fps))
        if (loop, segment.group) != group:
            group, tiers = (loop, segment.group), 0
        quality, level = _fetch_segment(player, position, index, [quality] if tiers else range(len(m.qualities)), tiers)
        tiers = max(tiers, m.levels[level].tiers)
        _show(player, loop, index, quality, level)
    return SessionLog(m, link, settings, tuple(player.fetches), tuple(player.shown), dict(player.bytes_by_kind))


def _check(m: Manifest, link: Link, settings: SessionSettings) -> None:
    measured = all(level.psnr for segment in m.segments for level in segment.levels)
    if settings.policy == "paper" and not measured:
        raise ConfigError("policy paper: the package has no measured quality, encode it without --measure-frames 0")
    if not 0 <= settings.fixed_level < len(m.levels):
        raise ConfigError(f"level: expected 0 to {len(m.levels) - 1}, got {settings.fixed_level}")
    if not 0 < settings.buffer_s < math.inf:
        raise ConfigError(f"buffer: expected more than 0 s, got {settings.buffer_s:g}")
    if not 0 <= settings.decode_frame_s < math.inf:
        raise ConfigError(f"decoding: expected 0 s a frame or more, got {settings.decode_frame_s:g}")
    if settings.loops is not None and settings.loops < 1:
        raise ConfigError(f"loops: expected at least 1, got {settings.loops}")
    if not 0 <= link.rtt_s < math.inf:
        raise ConfigError(f"round trip: expected 0 s or more, got {link.rtt_s:g}")


def _positions(m: Manifest, loops: int) -> Iterator[tuple[int, int]]:
    for loop in range(loops):
        for index in range(len(m.segments)):
            yield loop, index


def _wait_for_room(player: _Player, segment_s: float) -> None:
    """Let time pass until the next segment fits the buffer: media ahead of the playhead + segment <= buffer_s."""
    fps = float(player.manifest.fps)
    ahead = segment_s
    for shown in reversed(player.shown):
        length = shown.frames / fps
        if ahead + length > player.settings.buffer_s:
            room = max(0.0, player.settings.buffer_s - ahead)  # seconds of this one that may still lie ahead
            player.now_s = max(player.now_s, shown.start_s + length - room)
            return
        ahead += length


def _fetch_segment(player: _Player, position: int, index: int, qualities: Iterable[int], tiers: int) -> tuple[int, int]:
    """Choose among the rungs with those key qualities and fetch; gives key quality and level.

    `tiers` of the group's keys are at hand, none where it begins.
    """
    m, s = player.manifest, player.manifest.segments[index]
    rungs = [(q, j) for q in qualities for j in range(len(m.levels))]
    batches = []
    for q, j in rungs:
        keys = [path for t in range(tiers, m.levels[j].tiers) for path in m.key_files(s.group, t, q)]
        batches.append(keys + m.state_files(index, j))
    measured = [s.levels[j].psnr[q] if s.levels[j].psnr else 0.0 for q, j in rungs]
    options = tuple(Point(i, m.bytes_of(batches[i]), measured[i], m.levels[j].pruned) for i, (_, j) in enumerate(rungs))
    state = PlayerState(
        now_s=player.now_s,
        deadline_s=player.end_s() - player.settings.decode_frame_s,
        segment_s=float((s.stop - s.start) / m.fps),
        rtt_s=player.link.rtt_s,
        history=tuple(player.history),
        files=max(len(batch) for batch in batches),
        options=options,
    )
    fixed = rungs.index((rungs[0][0], player.settings.fixed_level))
    decision = choose_paper(state) if player.settings.policy == "paper" else choose_fixed(state, fixed)
    quality, level = rungs[decision.level]
    if batches[decision.level]:  # else nothing moves in this segment: the canonical space is at hand
        kind = "state" if tiers else "group"
        _fetch_files(player, kind, position, (quality, level), batches[decision.level], decision, budget_bytes(state))
    return quality, level


def _fetch_files(
    player: _Player,
    kind: str,
    position: int,
    rung: tuple[int, int],
    files: list[str],
    decision: Decision,
    budget: float,
) -> None:
    folders = {path.rpartition("/")[0] for path in files}
    inits = [path for path in player.manifest.init_files(*rung) if path.rpartition("/")[0] in folders]
    new = [path for path in inits if path not in player.fetched_once]
    player.fetched_once.update(new)
    sizes = player.manifest.files
    player.count("init", sum(sizes[path].bytes for path in new))
    for path in files:
        player.count("sidecars" if path.endswith(".bin") else path.split("/")[0], sizes[path].bytes)
    player.fetch(kind, position, [sizes[path].bytes for path in new + files], decision, budget)


def _show(player: _Player, loop: int, index: int, quality: int, level: int) -> None:
    """The segment plays after the one before it, or when its first frame is decoded, whichever is later."""
    s = player.manifest.segments[index]
    ready = player.now_s + player.settings.decode_frame_s
    due = player.end_s() if player.shown else ready
    start = max(due, ready)
    measured = s.levels[level].psnr
    psnr = measured[quality] if measured else None
    player.shown.append(Shown(index, loop, quality, level, ready, start, s.stop - s.start, start - due, psnr))


def screen_ticks(log: SessionLog) -> list[tuple[int, int]]:
    """For every display tick (1 / fps) from the first picture on: which entry of `shown`, which frame of it.

    While the player waits, the last frame stays.
    """
    fps = float(log.manifest.fps)
    ticks: list[tuple[int, int]] = []
    for i, shown in enumerate(log.shown):
        if i:
            ticks += [(i - 1, log.shown[i - 1].frames - 1)] * round(shown.stall_s * fps)
        ticks += [(i, frame) for frame in range(shown.frames)]
    return ticks


def metrics(log: SessionLog) -> dict[str, object]:
    """What the session was like. PSNR counts every display tick, frozen ones with the picture that stood."""
    m, shown = log.manifest, log.shown
    played = sum(s.frames for s in shown) / float(m.fps)
    stalls = [s.stall_s for s in shown if s.stall_s > 1e-9]
    per_tick = [shown[i].psnr for i, _ in screen_ticks(log)]
    psnr = np.array([p for p in per_tick if p is not None])
    rungs = [(s.quality, s.level) for s in shown]
    names = Counter(f"{m.qualities[q].id}+{m.levels[j].id}" for q, j in rungs)
    return {
        "frames": sum(s.frames for s in shown),
        "played_s": played,
        "startup_s": shown[0].start_s,
        "stalls": len(stalls),
        "stall_s": math.fsum(stalls),
        "stall_ratio": math.fsum(stalls) / (played + math.fsum(stalls)),
        "switches": sum(a != b for a, b in itertools.pairwise(rungs)),
        "psnr_mean": float(psnr.mean()) if len(psnr) else None,
        "psnr_p5": float(np.percentile(psnr, 5)) if len(psnr) else None,
        "bytes": dict(log.bytes_by_kind),
        "bytes_per_frame": sum(log.bytes_by_kind.values()) / sum(s.frames for s in shown),
        "wire_bytes": sum(f.bytes for f in log.fetches),
        "rungs": dict(names.most_common()),
        "trace": log.link.trace.name,
        "trace_mean_bps": log.link.trace.mean_bps,
        "trace_scale": log.link.trace.scale,
        "trace_offset_s": log.link.trace.offset_s,
        "trace_looped": log.fetches[-1].arrival_s > log.link.trace.duration_s,
        "rtt_s": log.link.rtt_s,
    }
