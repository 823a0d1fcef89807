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
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from airgs_codec.errors import ConfigError
from airgs_codec.play.catalogue import Catalogue
from airgs_codec.play.ladder import Decision, Option
from airgs_codec.play.link import Link
from airgs_codec.play.player import Buffered, Fetch, Player, SessionSettings
from airgs_codec.play.policy import SAFETY, PlayerState, Policy, budget_bytes, estimate_throughput, make_policy

CHECK_S = 0.5  # a download is looked at so often, and given so long before the first look
REPLACE_GAIN_DB = 0.5  # least gain that a replacement must bring


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
    """Everything that happened; `outcome` derives figures from it."""

    catalogue: Catalogue
    link: Link
    settings: SessionSettings
    fetches: tuple[Fetch, ...]
    shown: tuple[Shown, ...]
    bytes_by_kind: Mapping[str, int]
    lost: tuple[str, ...]  # what could not be had, one line each


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
    player = Player(c, link, settings, c.loops(settings.loops) * len(c.seconds), faults or {}, link.rtt_s)
    wire = c.wire_bytes([manifest_bytes])
    player.wait(wire)
    player.fetches.append(Fetch("manifests", 0, 0, wire, 0, 0.0, player.now_s, 0.0, 0.0, True, "start"))
    player.bytes_by_kind["manifests"] += manifest_bytes
    replaces = settings.replace and not settings.policy.startswith(("fixed", "oracle"))
    for position in range(player.end):
        room = player.room_s(position)
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
    shown = tuple(_shown(player, segment) for segment in player.line)
    return SessionLog(c, link, settings, tuple(player.fetches), shown, dict(player.bytes_by_kind), tuple(player.lost))


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


def _fetch_next(player: Player, position: int, choose: Policy) -> bool:
    """Choose a rung of the next segment and fetch it; False: it was abandoned or broken, choose again."""
    state = _state(player, position)
    if not state.options:
        segment = player.catalogue.manifest.segments[state.segment]
        frames = f"frames {segment.start}-{segment.stop - 1}"
        player.lost.append(f"{frames} at {player.now_s:.2f} s: no rung can be had, the last picture stands")
        player.line_up(position, None)
        return True
    decision = choose(state)
    files = player.files(position, decision.index)
    if files and not _fetch(player, state, decision, files):
        return False
    player.line_up(position, decision.index)  # without files nothing moves: the canonical space is at hand
    return True


def _state(player: Player, position: int) -> PlayerState:
    c, held, segment = player.catalogue, player.held(position), player.index(position)
    options = c.options(segment, held)
    if player.given_up[0] == position:
        options = tuple(p for p in options if p.size_bytes < player.given_up[1])
    if player.bad:
        options = tuple(p for p in options if not player.bad.intersection(c.files(segment, p.index, held)))
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
        shown_quality=player.quality(player.line[-1]) if player.line else None,
        history=player.history,
    )


def _fetch(player: Player, state: PlayerState, decision: Decision, files: list[str]) -> bool:
    """Fetch what a rung of the next segment needs; False when it did not come whole."""
    began, stop_s, reason = player.asked_s, None, decision.reason
    if player.settings.abandon and not player.settings.policy.startswith("fixed"):
        stop_s = _abandoned_s(player, state, decision, files)
    if stop_s is not None:
        player.given_up = state.position, decision.size_bytes
        reason += f"; abandoned after {stop_s - began:.2f} s"
    wire, whole = player.receive(state.position, decision.index, files, stop_s)
    complete = len(whole) == len(files)
    player.fetches.append(
        Fetch(
            kind="group" if any(path.startswith("key/") for path in files) else "state",
            position=state.position,
            rung=decision.index,
            bytes=wire,
            wasted=0 if complete else max(0, wire - sum(player.wire_sizes(whole))),
            request_s=began,
            arrival_s=player.now_s,
            budget_bytes=budget_bytes(state),
            throughput_bps=estimate_throughput(state.history),
            fits=decision.fits,
            reason=reason,
        )
    )
    return complete


def _abandoned_s(player: Player, state: PlayerState, decision: Decision, files: list[str]) -> float | None:
    """When the download now to be requested is given up, None if it is not.

    Looked at every CHECK_S: it is given up if, at the rate so far, it comes after its deadline and the smallest rung,
    asked for now, would come sooner.
    """
    link, wire = player.link, sum(player.wire_sizes(files))
    first = player.now_s + player.trip_s
    arrival = link.trace.arrival_s(wire, first)
    smallest = min(p.size_bytes for p in state.options)
    deadline = max(state.deadline_s, player.now_s)
    if smallest >= decision.size_bytes:
        return None
    for look in itertools.count(1):
        at = first + CHECK_S * look
        if at >= arrival:
            return None
        passed = link.bytes_between(first, at)
        rate = max(passed, 1.0) / (at - first)
        left = (wire - passed) / rate
        if at + left > deadline and left > link.rtt_s + smallest / rate:
            return at
    return None


def _replace(player: Player) -> bool:
    """Fetch the replacement that gains most for its bytes, if any will be in time; False if there is none."""
    best = max(_replacements(player), key=lambda r: r[0], default=None)
    if best is None:
        return False
    _, segment, option = best
    before, estimate, began = player.quality(segment), estimate_throughput(player.history), player.now_s
    files = _replacing_files(player, segment, option.index)
    wire, whole = player.receive(segment.position, option.index, files)
    late = player.now_s + player.settings.decode_frame_s > segment.start_s
    useless = late or len(whole) < len(files)
    player.fetches.append(
        Fetch(
            kind="better",
            position=segment.position,
            rung=option.index,
            bytes=wire,
            wasted=wire if useless else 0,
            request_s=began,
            arrival_s=player.now_s,
            budget_bytes=0.0,
            throughput_bps=estimate,
            fits=True,
            reason=f"{option.quality:.1f} dB in place of {before:.1f}" + "; too late" * late,
        )
    )
    if not useless:
        _put_in_place(player, segment, option.index)
    return True


def _replacements(player: Player) -> Iterator[tuple[float, Buffered, Option]]:
    """(dB seconds a byte, segment, rung) of everything that would be better and is expected in time."""
    c, rate = player.catalogue, SAFETY * estimate_throughput(player.history)
    for segment in player.line:
        here = player.quality(segment)
        if here is None or not player.now_s < segment.start_s < math.inf:
            continue
        index, level = player.index(segment.position), c.rungs[segment.rung or 0][1]
        for option in c.options(index, player.held(segment.position)):
            gain = option.quality - here
            size = option.size_bytes  # the state is at hand where only the keys would be better
            size -= int(c.state_bytes[index, level]) if c.rungs[option.index][1] == level else 0
            arrival = player.now_s + player.link.rtt_s + 8 * size / rate
            if gain < REPLACE_GAIN_DB or arrival + player.settings.decode_frame_s > segment.start_s:
                continue
            if not player.bad.intersection(_replacing_files(player, segment, option.index)):
                yield gain * player.seconds(segment.position) / max(1, size), segment, option


def _replacing_files(player: Player, segment: Buffered, rung: int) -> list[str]:
    """What it takes to show another rung of a buffered segment."""
    rungs = player.catalogue.rungs
    same = rungs[rung][1] == rungs[segment.rung or 0][1]
    return [path for path in player.files(segment.position, rung) if not (same and path.startswith("state/"))]


def _put_in_place(player: Player, segment: Buffered, rung: int) -> None:
    """Show the replacement just fetched; a state that it takes the place of was fetched in vain."""
    c = player.catalogue
    old = c.rungs[segment.rung or 0][1]
    if c.rungs[rung][1] != old:
        replaced, state = player.fetches[segment.fetch], c.state_bytes[player.index(segment.position), old]
        player.fetches[segment.fetch] = replace(replaced, wasted=replaced.wasted + int(state))
        segment.fetch = len(player.fetches) - 1
    segment.rung = rung


def _shown(player: Player, segment: Buffered) -> Shown:
    c = player.catalogue
    loop, index = divmod(segment.position, len(c.seconds))
    entry, times = c.manifest.segments[index], (segment.ready_s, segment.start_s)
    psnr = player.quality(segment) if c.measured else None
    return Shown(index, loop, segment.rung, *times, entry.stop - entry.start, segment.stall_s, psnr)
