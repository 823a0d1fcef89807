"""A viewer over a link: requests, arrivals, choices, stalls. Event-driven, deterministic, no clock.

One batch passes at a time: those key units of the chosen rung that are not at hand, in tier order, then the state
segment. With `ahead` the next batch is asked for a round trip before the last byte of the one before, so that the link
does not stand idle; the choice then knows one download less. When nothing more fits the buffer, a buffered segment may
be replaced by a better rung (with it better keys of its group) as long as it will be there in time. A download that
would come too late is abandoned when a smaller one would come sooner; whole files that have arrived are kept. A segment
none of whose rungs can be had is lost: the last picture stands for its time, and the session goes on.

The sequence may be played `loops` times, as if it were longer: keys and states are fetched again, init segments and
manifests are not. Times are seconds from the first request.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from airgs_codec.errors import ConfigError
from airgs_codec.play.catalogue import Catalogue
from airgs_codec.play.link import Link
from airgs_codec.play.optimum import Horizon, Unit, solve_horizon
from airgs_codec.play.policy import (
    SAFETY,
    STALL_DB,
    Download,
    PlayerState,
    Policy,
    budget_bytes,
    estimate_throughput,
    make_policy,
)
from airgs_codec.play.select import Decision, Point

SHORTEST_S = 1e-9  # a download that rounds to no time still has a rate
SESSION_S = 30.0  # what `loops` aims at when it is not given
CHECK_S = 0.5  # a download is looked at so often, and given so long before the first look
REPLACE_GAIN_DB = 0.5  # least gain that a replacement must bring


@dataclass(frozen=True, slots=True)
class SessionSettings:
    """Rules of the player."""

    policy: str = "paper"
    buffer_s: float = 10.0  # most media time ahead of the playhead
    startup_s: float = 1.0  # media at hand before playing begins; one segment at least
    resume_s: float = 0.5  # the same after a stall
    decode_frame_s: float = 0.004  # time to decode and apply a frame
    replace: bool = True  # buffered segments by better ones
    abandon: bool = True
    ahead: bool = True  # ask for the next segment a round trip before the last batch is there, knowing so much less
    loops: int | None = None  # default: about SESSION_S of play


@dataclass(frozen=True, slots=True)
class Fetch:
    """One batch on the wire."""

    kind: str  # manifests, group (keys and state), state, better (a replacement)
    position: int  # of the segment in the session
    rung: int
    bytes: int  # with headers; of an abandoned batch, what had passed
    wasted: int  # of them: abandoned, too late or replaced later
    request_s: float
    arrival_s: float
    budget_bytes: float
    throughput_bps: float  # the estimate at the request
    fits: bool
    reason: str


@dataclass(frozen=True, slots=True)
class Shown:
    """One segment on the screen; `rung` None: lost, the last picture stands."""

    segment: int  # in the manifest
    loop: int
    rung: int | None
    ready_s: float
    start_s: float  # of its display
    frames: int
    stall_s: float  # waited for before it
    psnr: float | None


@dataclass(frozen=True, slots=True, eq=False)
class SessionLog:
    """Everything that happened; metrics are derived from it."""

    catalogue: Catalogue
    link: Link
    settings: SessionSettings
    fetches: tuple[Fetch, ...]
    shown: tuple[Shown, ...]
    bytes_by_kind: Mapping[str, int]
    lost: tuple[str, ...]  # what could not be had, one line each


@dataclass(slots=True)
class _Segment:
    """A segment at hand or on the screen."""

    position: int
    rung: int | None
    ready_s: float
    fetch: int = -1  # which batch brought it
    start_s: float = math.inf  # unknown while the player waits for more
    stall_s: float = 0.0


@dataclass(slots=True, eq=False)
class _Player:
    catalogue: Catalogue
    link: Link
    settings: SessionSettings
    end: int
    faults: Mapping[str, str]
    now_s: float = 0.0
    history: list[Download] = field(default_factory=list)
    fetches: list[Fetch] = field(default_factory=list)
    line: list[_Segment] = field(default_factory=list)  # by position
    first_waiting: int = 0  # of `line`: those from here on have no start yet
    keys: dict[tuple[int, int], dict[int, int]] = field(default_factory=dict)  # (loop, group) -> quality -> tiers
    once: set[str] = field(default_factory=set)  # init segments at hand
    bytes_by_kind: Counter[str] = field(default_factory=Counter)
    lost: list[str] = field(default_factory=list)
    trip_s: float = 0.0  # of the round trip of the next batch, what is left when the one before is there
    given_up: tuple[int, int] = (-1, 0)  # position and size: nothing as large is asked for there again
    bad: set[str] = field(default_factory=set)  # files found missing or corrupt

    def seconds(self, position: int) -> float:
        return self.catalogue.seconds[position % len(self.catalogue.seconds)]

    def group(self, position: int) -> tuple[int, int]:
        segments = self.catalogue.manifest.segments
        loop, index = divmod(position, len(segments))
        return loop, segments[index].group

    def held(self, position: int) -> dict[int, int]:
        return self.keys.setdefault(self.group(position), {})

    def end_s(self) -> float:
        """When what is at hand will have been shown; while it waits, as if it went on now."""
        waiting = sum(self.seconds(s.position) for s in self.line[self.first_waiting :])
        if self.first_waiting == 0:
            return self.now_s + waiting
        last = self.line[self.first_waiting - 1]
        return max(last.start_s + self.seconds(last.position), self.now_s if waiting else -math.inf) + waiting


def simulate(
    catalogue: Catalogue,
    manifest_bytes: int,
    link: Link,
    settings: SessionSettings,
    faults: Mapping[str, str] | None = None,
) -> SessionLog:
    """Play the package over the link. `faults`: files that cannot be used, and what is wrong with them.

    Raises ConfigError for settings that cannot work, TransportError for a trace that ends too soon.
    """
    c = catalogue
    choose = make_policy(settings.policy, c, link)
    _check(c, link, settings)
    duration = sum(c.seconds)
    loops = settings.loops or max(1, round(SESSION_S / duration))
    player = _Player(c, link, settings, loops * len(c.seconds), faults or {}, trip_s=link.rtt_s)
    wire = c.wire_bytes([manifest_bytes])
    _pass(player, wire)
    player.fetches.append(Fetch("manifests", 0, 0, wire, 0, 0.0, player.now_s, 0.0, 0.0, True, "start"))
    player.bytes_by_kind["manifests"] += manifest_bytes
    replaces = settings.replace and not settings.policy.startswith(("fixed", "oracle"))
    for position in range(player.end):
        room = _room_s(player, position)
        while replaces and player.now_s < room and _replace(player):
            pass
        if settings.ahead and position and room < player.now_s:
            player.trip_s = max(0.0, link.rtt_s - (player.now_s - room))
        player.now_s = max(player.now_s, room)
        while not _fetch_next(player, position, choose):
            player.trip_s = link.rtt_s
        player.trip_s = link.rtt_s
    while replaces and _replace(player):
        pass
    return SessionLog(
        c,
        link,
        settings,
        tuple(player.fetches),
        tuple(_shown(player)),
        dict(player.bytes_by_kind),
        tuple(player.lost),
    )


def _check(c: Catalogue, link: Link, settings: SessionSettings) -> None:
    if not settings.policy.startswith("fixed") and not c.measured:
        raise ConfigError(
            f"policy {settings.policy}: the package has no measured quality, encode it without --measure-frames 0"
        )
    if not 0 < settings.buffer_s < math.inf:
        raise ConfigError(f"buffer: expected more than 0 s, got {settings.buffer_s:g}")
    for name, value in (("start-up", settings.startup_s), ("resume", settings.resume_s)):
        if not 0 <= value < math.inf:
            raise ConfigError(f"{name}: expected 0 s or more, got {value:g}")
    if not 0 <= settings.decode_frame_s < math.inf:
        raise ConfigError(f"decoding: expected 0 s a frame or more, got {settings.decode_frame_s:g}")
    if settings.loops is not None and settings.loops < 1:
        raise ConfigError(f"loops: expected at least 1, got {settings.loops}")
    if not 0 <= link.rtt_s < math.inf:
        raise ConfigError(f"round trip: expected 0 s or more, got {link.rtt_s:g}")


def _pass(player: _Player, wire: int) -> None:
    """Request so many bytes now and wait for the last of them."""
    arrival = player.link.trace.arrival_s(wire, player.now_s + player.trip_s)
    player.history.append(Download(wire, max(arrival - player.now_s - player.trip_s, SHORTEST_S)))
    player.now_s = arrival


def _room_s(player: _Player, position: int) -> float:
    """When the segment fits the buffer: media ahead of the playhead and the segment <= buffer_s. In the past if now."""
    ahead = player.seconds(position)
    for segment in reversed(player.line):
        length = player.seconds(segment.position)
        if ahead + length > player.settings.buffer_s:
            if segment.start_s == math.inf:  # it waits to resume with a full buffer: it need not
                _resume(player)
            return segment.start_s + length - max(0.0, player.settings.buffer_s - ahead)
        ahead += length
    return -math.inf


def _fetch_next(player: _Player, position: int, choose: Policy) -> bool:
    """Choose a rung of the next segment and fetch it; False: it was abandoned or broken, choose again."""
    state = _state(player, position)
    if not state.options:
        segment = player.catalogue.manifest.segments[state.segment]
        frames = f"frames {segment.start}-{segment.stop - 1}"
        player.lost.append(f"{frames} at {player.now_s:.2f} s: no rung can be had, the last picture stands")
        _line_up(player, _Segment(position, None, player.now_s))
        return True
    return _fetch(player, state, choose(state))


def _state(player: _Player, position: int) -> PlayerState:
    c, held = player.catalogue, player.held(position)
    segment = position % len(c.seconds)
    options = c.options(segment, held)
    if player.given_up[0] == position:
        options = tuple(p for p in options if p.size_bytes < player.given_up[1])
    if player.bad:
        options = tuple(p for p in options if not player.bad.intersection(c.files(segment, p.level, held)))
    before = player.line[-1] if player.line else None
    quality = None if before is None or before.rung is None else float(c.quality[_index(player, before), before.rung])
    return PlayerState(
        catalogue=c,
        position=position,
        end=player.end,
        held=held,
        options=options,
        now_s=player.now_s,
        deadline_s=player.end_s() - player.settings.decode_frame_s,
        buffer_limit_s=player.settings.buffer_s,
        rtt_s=player.trip_s,
        shown_quality=quality,
        history=tuple(player.history[-24:] if player.trip_s == player.link.rtt_s else player.history[-25:-1]),
    )


def _index(player: _Player, segment: _Segment) -> int:
    return segment.position % len(player.catalogue.seconds)


def _fetch(player: _Player, state: PlayerState, decision: Decision) -> bool:
    """Fetch a rung of the next segment; False when it did not come whole."""
    files = _files(player, state.position, decision.level)
    kind = "state" if not any(path.startswith("key/") for path in files) else "group"
    began = player.now_s - (player.link.rtt_s - player.trip_s)
    if files:  # else nothing moves in this segment: the canonical space is at hand
        estimate, budget = estimate_throughput(state.history), budget_bytes(state)
        fixed = player.settings.policy.startswith("fixed") or not player.settings.abandon
        stop_s = None if fixed else _abandoned_s(player, state, decision, files)
        if stop_s is not None:
            player.given_up = state.position, decision.size_bytes
        whole = _receive(player, state.position, decision.level, files, stop_s)
        wire = player.history[-1].bytes
        kept = player.catalogue.wire_bytes([player.catalogue.manifest.files[f].bytes for f in whole])
        wasted = 0 if len(whole) == len(files) else max(0, wire - kept)
        reason = decision.reason if stop_s is None else f"{decision.reason}; abandoned after {stop_s - began:.2f} s"
        player.fetches.append(
            Fetch(
                kind,
                state.position,
                decision.level,
                wire,
                wasted,
                began,
                player.now_s,
                budget,
                estimate,
                decision.fits,
                reason,
            )
        )
        if len(whole) < len(files):
            return False
    _line_up(player, _Segment(state.position, decision.level, player.now_s, len(player.fetches) - 1))
    return True


def _files(player: _Player, position: int, rung: int) -> list[str]:
    """What a rung of a segment still needs, each init segment before the first of its files."""
    c = player.catalogue
    files = c.files(position % len(c.seconds), rung, player.held(position))
    folders = {path.rpartition("/")[0] for path in files}
    inits = [p for p in c.manifest.init_files(*c.rungs[rung]) if p.rpartition("/")[0] in folders]
    return [path for path in inits if path not in player.once] + files


def _receive(player: _Player, position: int, rung: int, files: list[str], stop_s: float | None) -> list[str]:
    """Wait for a batch, or until `stop_s`; gives the files of it that are at hand.

    Those came whole and are what they should be; a state without the rest of its batch is of no use and is dropped.
    """
    manifest, link = player.catalogue.manifest, player.link
    sizes = [0 if player.faults.get(f) == "missing" else manifest.files[f].bytes for f in files]
    wire = player.catalogue.wire_bytes(sizes)
    if stop_s is None:
        _pass(player, wire)
        came = files
    else:
        first = player.now_s + player.trip_s
        passed = link.bytes_between(first, stop_s)
        player.history.append(Download(max(1, round(passed)), max(stop_s - first, SHORTEST_S)))
        ends = itertools.accumulate(size + player.catalogue.header_bytes for size in sizes)
        came = [f for f, end in zip(files, ends, strict=True) if end <= passed]
        player.now_s = stop_s
    for path in came:
        if path in player.faults:
            player.bad.add(path)
            player.lost.append(f"{path} at {player.now_s:.2f} s: {player.faults[path]}")
    whole = [path for path in came if path not in player.faults]
    if len(whole) < len(files):
        whole = [path for path in whole if path.startswith("key/") or path.endswith("init.mp4")]
    for path in whole:
        kind = "init" if path.endswith("init.mp4") else "sidecars" if path.endswith(".bin") else path.split("/")[0]
        player.bytes_by_kind[kind] += manifest.files[path].bytes
    player.once.update(path for path in whole if path.endswith("init.mp4"))
    held, (quality, level) = player.held(position), player.catalogue.rungs[rung]
    while (tier := held.get(quality, 0)) < manifest.levels[level].tiers:
        if not set(manifest.key_files(player.group(position)[1], tier, quality)) <= set(whole):
            break
        held[quality] = tier + 1
    _use_keys(player, position, quality)
    return whole


def _use_keys(player: _Player, position: int, quality: int) -> None:
    """Show what is buffered of a group with its best keys, where they are decoded in time."""
    c, held = player.catalogue, player.held(position)
    ready_s = player.now_s + player.settings.decode_frame_s
    for segment in player.line:
        if segment.rung is None or player.group(segment.position) != player.group(position):
            continue
        q, j = c.rungs[segment.rung]
        if quality < q and segment.start_s >= ready_s and held.get(quality, 0) >= c.manifest.levels[j].tiers:
            segment.rung = c.rungs.index((quality, j))


def _abandoned_s(player: _Player, state: PlayerState, decision: Decision, files: list[str]) -> float | None:
    """When the download now to be requested is given up, None if it is not.

    Looked at every CHECK_S: it is given up if, at the rate so far, it comes after its deadline and the smallest rung,
    asked for now, would come sooner.
    """
    link = player.link
    wire = player.catalogue.wire_bytes([player.catalogue.manifest.files[f].bytes for f in files])
    first = player.now_s + player.trip_s
    arrival = link.trace.arrival_s(wire, first)
    smallest = min(p.size_bytes for p in state.options)
    deadline = max(state.deadline_s, player.now_s)
    for look in itertools.count(1):
        at = first + CHECK_S * look
        if at >= arrival:
            return None
        passed = link.bytes_between(first, at)
        rate = max(passed, 1.0) / (at - first)
        left = (wire - passed) / rate
        if at + left > deadline and left > link.rtt_s + smallest / rate and smallest < decision.size_bytes:
            return at
    return None


def _line_up(player: _Player, segment: _Segment) -> None:
    """A segment is at hand; playing begins or goes on when enough is."""
    first_frame = player.settings.decode_frame_s if segment.rung is not None else 0.0
    segment.ready_s += first_frame
    player.line.append(segment)
    waiting = player.line[player.first_waiting :]
    before = player.line[player.first_waiting - 1] if player.first_waiting else None
    due = before.start_s + player.seconds(before.position) if before else -math.inf
    if len(waiting) == 1 and segment.ready_s <= due:
        segment.start_s = due
        player.first_waiting += 1
        return
    wanted = player.settings.resume_s if before else player.settings.startup_s
    last = segment.position == player.end - 1
    if last or sum(player.seconds(s.position) for s in waiting) >= wanted:
        _resume(player)


def _resume(player: _Player) -> None:
    """Show what waits, one segment after another, from the moment all of it was ready."""
    waiting = player.line[player.first_waiting :]
    before = player.line[player.first_waiting - 1] if player.first_waiting else None
    due = before.start_s + player.seconds(before.position) if before else -math.inf
    at = max(due, *(segment.ready_s for segment in waiting))
    waiting[0].stall_s = at - due if before else 0.0
    for segment in waiting:
        segment.start_s = at
        at += player.seconds(segment.position)
    player.first_waiting = len(player.line)


def _replace(player: _Player) -> bool:
    """Fetch the replacement that gains most for its bytes, if any will be in time; False if there is none."""
    rate = SAFETY * estimate_throughput(player.history)
    best: tuple[float, _Segment, Point] | None = None
    for segment in player.line:
        if segment.rung is None or segment.start_s <= player.now_s or segment.start_s == math.inf:
            continue
        here = float(player.catalogue.quality[_index(player, segment), segment.rung])
        for option in _better(player, segment):
            arrival = player.now_s + player.link.rtt_s + 8 * option.size_bytes / rate
            gain = option.quality - here
            if gain < REPLACE_GAIN_DB or arrival + player.settings.decode_frame_s > segment.start_s:
                continue
            worth = gain * player.seconds(segment.position) / max(1, option.size_bytes)
            if best is None or worth > best[0]:
                best = (worth, segment, option)
    if best is None:
        return False
    _, segment, option = best
    files = _replacement(player, segment, option.level)
    before = float(player.catalogue.quality[_index(player, segment), segment.rung or 0])
    began, estimate = player.now_s, estimate_throughput(player.history)
    whole = _receive(player, segment.position, option.level, files, None)
    ready = player.now_s + player.settings.decode_frame_s
    late = ready > segment.start_s
    useless = late or len(whole) < len(files)
    wire = player.history[-1].bytes
    reason = f"{option.quality:.1f} dB in place of {before:.1f}" + "; too late" * late
    player.fetches.append(
        Fetch(
            "better",
            segment.position,
            option.level,
            wire,
            wire if useless else 0,
            began,
            player.now_s,
            0.0,
            estimate,
            True,
            reason,
        )
    )
    if not useless:
        _improve(player, segment, option.level)
    return True


def _better(player: _Player, segment: _Segment) -> Iterator[Point]:
    """Rungs that a buffered segment could have instead; its state is at hand where only the keys would be better."""
    c, index, held = player.catalogue, _index(player, segment), player.held(segment.position)
    _, level = c.rungs[segment.rung or 0]
    for option in c.options(index, held):
        size = option.size_bytes
        if c.rungs[option.level][1] == level:
            size -= int(c.state_bytes[index, level])
        if not player.bad or not player.bad.intersection(_replacement(player, segment, option.level)):
            yield Point(option.level, size, option.quality, option.pruned)


def _replacement(player: _Player, segment: _Segment, rung: int) -> list[str]:
    """What it takes to show another rung of a buffered segment."""
    files = _files(player, segment.position, rung)
    same = player.catalogue.rungs[rung][1] == player.catalogue.rungs[segment.rung or 0][1]
    return [path for path in files if not (same and path.startswith("state/"))]


def _improve(player: _Player, segment: _Segment, rung: int) -> None:
    """Put a better rung in place."""
    c = player.catalogue
    old = c.rungs[segment.rung or 0][1]
    if c.rungs[rung][1] != old:
        replaced = player.fetches[segment.fetch]
        state = int(c.state_bytes[_index(player, segment), old])
        player.fetches[segment.fetch] = replace(replaced, wasted=replaced.wasted + state)
        segment.fetch = len(player.fetches) - 1
    segment.rung = rung


def _shown(player: _Player) -> Iterator[Shown]:
    c = player.catalogue
    for segment in player.line:
        loop, index = divmod(segment.position, len(c.seconds))
        entry = c.manifest.segments[index]
        measured = None if segment.rung is None else entry.levels[c.rungs[segment.rung][1]].psnr
        yield Shown(
            index,
            loop,
            segment.rung,
            segment.ready_s,
            segment.start_s,
            entry.stop - entry.start,
            segment.stall_s,
            measured[c.rungs[segment.rung or 0][0]] if measured else None,
        )


def screen_ticks(log: SessionLog) -> list[tuple[int, int]]:
    """For every display tick (1 / fps) from the first picture on: which entry of `shown`, which frame of it.

    While the player waits, the last frame stays.
    """
    ticks: list[tuple[int, int]] = []
    for i, shown in enumerate(log.shown):
        if i:
            ticks += [(i - 1, log.shown[i - 1].frames - 1)] * round(shown.stall_s * log.catalogue.fps)
        ticks += [(i, frame) for frame in range(shown.frames)]
    return ticks


def metrics(log: SessionLog) -> dict[str, object]:
    """What the session was like. PSNR counts every display tick, frozen ones with the picture that stood.

    Frames of lost segments have no measured quality; they are counted apart and not in PSNR.
    """
    c, shown = log.catalogue, log.shown
    frames = sum(s.frames for s in shown)
    played = frames / c.fps
    stalls = [s.stall_s for s in shown if s.stall_s > 1e-9]
    stall = math.fsum(stalls)
    per_tick = [shown[i].psnr for i, _ in screen_ticks(log)]
    psnr = np.array([p for p in per_tick if p is not None])
    quality = [s.psnr for s in shown if s.psnr is not None]
    changes = [abs(b - a) for a, b in itertools.pairwise(quality)]
    rungs = [s.rung for s in shown]
    wire = sum(f.bytes for f in log.fetches)
    choices = [f for f in log.fetches if f.kind in ("group", "state")]
    end = max(f.arrival_s for f in log.fetches)
    took = frame_times(log)
    return {
        "frames": frames,
        "played_s": played,
        "startup_s": shown[0].start_s,
        "stalls": len(stalls),
        "stall_s": stall,
        "stall_ratio": stall / (played + stall),
        "switches": sum(a != b for a, b in itertools.pairwise(rungs)),
        "psnr_mean": float(psnr.mean()) if len(psnr) else None,
        "psnr_p5": float(np.percentile(psnr, 5)) if len(psnr) else None,
        "change_db": float(np.mean(changes)) if changes else 0.0,
        "qoe": (sum(quality) - sum(changes) - STALL_DB * stall) / len(quality) if quality else None,
        "bytes": dict(log.bytes_by_kind),
        "bytes_per_frame": sum(log.bytes_by_kind.values()) / frames,
        "wire_bytes": wire,
        "wasted": sum(f.wasted for f in log.fetches) / wire,
        "utilisation": wire / max(1.0, log.link.bytes_between(0.0, end)),
        "replaced": sum(f.kind == "better" for f in log.fetches),
        "abandoned": sum("abandoned" in f.reason for f in log.fetches),
        "late": sum(s.stall_s > 1e-9 for s in shown) / len(shown),
        "infeasible": sum(not f.fits for f in choices) / max(1, len(choices)),
        "lost_frames": sum(s.frames for s in shown if s.rung is None),
        "frame_ms_mean": float(1e3 * took.mean()) if len(took) else 0.0,
        "frame_ms_p50": float(1e3 * np.percentile(took, 50)) if len(took) else 0.0,
        "frame_ms_p95": float(1e3 * np.percentile(took, 95)) if len(took) else 0.0,
        "frame_ms_max": float(1e3 * took.max()) if len(took) else 0.0,
        "rungs": {"lost" if r is None else c.names[r]: count for r, count in Counter(rungs).most_common()},
        "trace": log.link.trace.name,
        "trace_mean_bps": log.link.trace.mean_bps,
        "trace_scale": log.link.trace.scale,
        "trace_offset_s": log.link.trace.offset_s,
        "trace_end": log.link.trace.end,
        "trace_ended": end > log.link.trace.duration_s,
        "rtt_s": log.link.rtt_s,
    }


def frame_times(log: SessionLog) -> np.ndarray:
    """Seconds that every frame shown was on its way: its share of the batch that brought it."""
    took = {f.position: f.arrival_s - f.request_s for f in log.fetches if f.kind != "manifests"}
    frames = [log.shown[p].frames for p in took]
    return np.repeat([t / n for t, n in zip(took.values(), frames, strict=True)], frames)


def session_bound(log: SessionLog, integer: bool = False) -> float | None:
    """dB: no player could have shown better at the same moments, see `optimum`. None when segments were lost."""
    units = []
    manifest_s = log.fetches[0].arrival_s
    c, link, limit = log.catalogue, log.link, log.settings.buffer_s
    fronts = np.cumsum([0.0, *(s.frames / c.fps for s in log.shown)])  # media time at which each begins
    for k, shown in enumerate(log.shown):
        if shown.rung is None:
            return None
        release = manifest_s
        wanted = float(fronts[k + 1]) - limit  # media that must have been shown before the request
        if wanted > 0:
            i = int(np.searchsorted(fronts, wanted - SHORTEST_S)) - 1  # before a stall, if one follows just there
            release = max(release, log.shown[i].start_s + wanted - float(fronts[i]))
        opens = (
            k == 0
            or shown.loop != log.shown[k - 1].loop
            or (c.manifest.segments[shown.segment].group != c.manifest.segments[log.shown[k - 1].segment].group)
        )
        deadline = shown.start_s - log.settings.decode_frame_s
        units.append(
            Unit(
                shown.segment,
                opens,
                link.bytes_between(0.0, release + link.rtt_s),
                link.bytes_between(0.0, deadline),
            )
        )
    plan = solve_horizon(Horizon(c, tuple(units), {}), integer)
    return None if plan is None else plan.quality


def mean_quality(log: SessionLog) -> float:
    """dB over media time, as `session_bound` counts it."""
    known = [(s.psnr, s.frames) for s in log.shown if s.psnr is not None]
    return sum(p * n for p, n in known) / sum(n for _, n in known)
