"""A player: requests, arrivals, choices and what is on the screen, as a stream of events. `run` starts one.

One batch passes at a time: those key units of the chosen rung that are not decoded, in tier order, then the state
segment. When nothing more fits the buffer, a buffered segment may be replaced by a better rung (with it better keys of
its group) as long as it will be there in time. A download that would come too late is abandoned when a smaller one
would come sooner; whole key files that have arrived are kept. A segment none of whose rungs can be had is lost: the
last picture stands for its time, and the session goes on.

What a batch offers stands in the table of its group: those of the first segments that the policy looks at are fetched
before the first batch, later ones with the batch before. A segment whose table cannot be had is lost. Rungs that show
more Gaussians than the budget are as if they could not be had.

The sequence may be played several times, as if it were longer: keys and states are fetched again, tables are not. One
that grows is played as it grows: airgs.json is fetched again a group's length after the last time, until it says that
nothing will follow, or nothing has followed for SILENCE_S. Times are seconds from the first request.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

from airgs_codec.errors import TransportError
from airgs_codec.package.paths import JSON_NAME
from airgs_codec.play.catalogue import Catalogue
from airgs_codec.play.downloader import Connection, Fetching, GiveUp, Partial, Steps, Wanted
from airgs_codec.play.events import Arrival, Arrived, Batch, BatchKind, Cut, Lost, Replaced, Request, Shown
from airgs_codec.play.keys import KeyStore, TableStore
from airgs_codec.play.ladder import Decision, Option
from airgs_codec.play.playout import Playout, Slot
from airgs_codec.play.policies.state import (
    SAFETY,
    Download,
    PlayerState,
    Policy,
    budget_bytes,
    estimate_throughput,
)
from airgs_codec.play.settings import SessionSettings

REPLACE_GAIN_DB = 0.5  # least gain that a replacement must bring
REMEMBERED = 24  # downloads that policies know
SHORTEST_S = 1e-9  # a download that rounds to no time still has a rate
POLL_S = 0.2  # airgs.json of a growing package is fetched no more often
SILENCE_S = 60.0  # without a new group: whoever added groups has gone


@dataclass(slots=True, eq=False)
class Player:
    """State of one session in which all tiles are fetched."""

    catalogue: Catalogue
    connection: Connection
    policy: Policy
    settings: SessionSettings
    tables: TableStore = field(init=False)
    keys: KeyStore = field(init=False)
    playout: Playout = field(init=False)
    now_s: float = 0.0  # when the last batch was over, or when there was room for the next
    downloads: list[tuple[float, Download]] = field(default_factory=list)  # with their arrivals
    unusable: set[str] = field(default_factory=set)  # files found missing or corrupt
    root_s: float = 0.0  # when airgs.json was asked for
    given_up: tuple[int, int] = (-1, 0)  # position and size: nothing as large is asked for there again

    def __post_init__(self) -> None:
        c = self.catalogue
        self.tables, self.keys = TableStore(c), KeyStore(c)
        self.playout = Playout(c, self.settings, c.end(c.loops(self.settings.loops)))

    def play(self) -> Steps:
        """All events of the session, in the order in which they happen."""
        yield from self._fetch_root(0)
        position = 0
        self.catalogue.limit(self.settings.budget)
        while position < self.playout.end or (yield from self._grow(position)):
            while wanted := self._wanted_tables(position):
                yield from self._fetch_tables(wanted, position)
            if not position:
                self.catalogue.check_budget([self.catalogue.index(0)])
            self.playout.make_room(position)
            earliest_s = self.playout.earliest_request_s(position)
            yield from self._wait(earliest_s)
            latency_s = self._latency_s(earliest_s) if position else self.connection.rtt_s
            self.now_s = max(self.now_s, earliest_s)
            while not (yield from self._fetch_next(position, latency_s)):
                latency_s = self.connection.rtt_s
            yield from self._shown(self.playout.started(self.now_s))
            position += 1
        yield from self._wait(math.inf)
        yield from self._shown(self.playout.started())

    def _wait(self, until_s: float) -> Steps:
        """Spend the time until the next request, or all that is left, on what is buffered."""
        while self.now_s < until_s and (yield from self._replace_best()):
            pass

    def _grow(self, position: int) -> Fetching[bool]:
        """Wait until a growing package has a segment for a position; False: it has ended before."""
        c, since_s = self.catalogue, self.now_s
        while c.live and c.end(1) <= position:
            if self.now_s >= since_s + SILENCE_S:
                yield Cut(self.now_s, f"no group has followed for {SILENCE_S:g} s")
                break
            ask_s = max(self.now_s, self.root_s + max(POLL_S, c.newest_seconds))
            yield from self._wait(ask_s)
            self.now_s = max(self.now_s, ask_s)
            yield from self._shown(self.playout.started(self.now_s))
            yield from self._fetch_root(position)
        if c.end(1) > position:
            self.playout.end = c.end(1)
            return True
        self.playout.finish(self.now_s)
        return False

    def _fetch_root(self, position: int) -> Steps:
        """Fetch airgs.json, and, as a package grows, the pages that now say what the root said before."""
        self.root_s = self.now_s
        yield from self._fetch_tables((JSON_NAME,), position)
        while (position or self.catalogue.live) and (pages := self.tables.missing_pages()):
            yield from self._fetch_tables(pages, position)
            if not self.unusable.isdisjoint(pages):
                raise TransportError(f"{', '.join(pages)}: expected the index of the growing package")

    def _wanted_tables(self, position: int) -> tuple[str, ...]:
        """Tables that the policy needs to choose at a position and that can be had."""
        reach = range(position, min(position + self.policy.horizon, self.playout.end))
        return tuple(path for path in self.tables.missing(reach) if path not in self.unusable)

    def _fetch_tables(self, paths: tuple[str, ...], position: int) -> Steps:
        request = Request(BatchKind.TABLES, position, 0, Batch(tables=paths), self.now_s, self.connection.rtt_s)
        arrival = yield from self._receive(request)
        yield Arrived(arrival, Decision(0, True, "tables", arrival.bytes), 0.0, 0.0)

    def _latency_s(self, earliest_s: float) -> float:
        """What is left of the round trip when the link is free: pipelined, the request was sent before."""
        rtt_s = self.connection.rtt_s
        if self.settings.pipelined and self.connection.pipelines and earliest_s < self.now_s:
            return max(0.0, rtt_s - (self.now_s - earliest_s))
        return rtt_s

    def _sent_s(self, latency_s: float) -> float:
        return self.now_s - (self.connection.rtt_s - latency_s)

    def _history(self, sent_s: float) -> tuple[Download, ...]:
        """The last downloads that are over when a request is sent, oldest first."""
        return tuple(d for at_s, d in self.downloads[-REMEMBERED:] if at_s <= sent_s + SHORTEST_S)

    def _receive(self, request: Request, give_up: GiveUp | None = None) -> Fetching[Arrival]:
        """Wait for a batch and keep what is of use; time goes on."""
        arrival = yield Wanted(request, give_up)
        assert arrival is not None, "a player that waits for a batch was sent none"
        self.now_s = arrival.at_s
        took_s = max(arrival.at_s - arrival.first_byte_s, SHORTEST_S)
        self.unusable.update(arrival.refused)
        self.tables.add(arrival)
        if request.kind is not BatchKind.TABLES:  # too small to tell the rate: they come in one burst
            self.downloads.append((arrival.at_s, Download(arrival.bytes, took_s)))
            self.keys.add(arrival)
            self._use_keys(request)
        return arrival

    def _use_keys(self, request: Request) -> None:
        """Show what is buffered of a group with its best keys, where they are decoded in time."""
        c, position = self.catalogue, request.position
        quality = c.rungs[request.rung][0]
        ready_s = self.now_s + self.settings.decode_frame_s
        for slot in self.playout.pending():
            if c.group(slot.position) != c.group(position) or slot.start_s < ready_s:
                continue
            shown_quality, level = c.rungs[slot.rung or 0]
            if quality < shown_quality and self.keys.shows(position, c.rungs.index((quality, level))):
                self.playout.replace(slot, c.rungs.index((quality, level)))

    def _fetch_next(self, position: int, latency_s: float) -> Fetching[bool]:
        """Choose a rung of the next segment and fetch it; False: it was abandoned or broken, choose again."""
        state = self._state(position, latency_s) if self.tables.has(position) else None
        if state is None or not state.options:
            yield from self._lose(position)
            return True
        decision = self.policy.choose(state)
        ahead = self._wanted_tables(position + 1) if position else ()  # nothing delays the first picture
        batch = replace(self.keys.missing(position, decision.index), tables=ahead)
        if batch.files:  # without files nothing moves: the canonical space is decoded
            kind = BatchKind.GROUP if batch.keys else BatchKind.STATE
            request = Request(kind, position, decision.index, batch, self._sent_s(latency_s), latency_s)
            arrival = yield from self._receive(request, self._give_up(state, decision))
            yield Arrived(arrival, decision, budget_bytes(state), estimate_throughput(state.history))
            if arrival.abandoned:
                self.given_up = position, decision.size_bytes
            if not arrival.complete:
                return False
        self.playout.enqueue(position, decision.index, self.now_s)
        return True

    def _lose(self, position: int) -> Steps:
        yield Lost(position, self.now_s)
        self.playout.enqueue(position, None, self.now_s)

    def _state(self, position: int, latency_s: float, tiles: Sequence[int] | None = None) -> PlayerState:
        """What is known before a segment is requested: all of it, or some tiles."""
        last = self.playout.last
        return PlayerState(
            catalogue=self.catalogue if tiles is None else self.catalogue.of_tiles(tiles),
            position=position,
            end=self.playout.end,
            decoded=self.keys.decoded(position),
            options=self._options(position, tiles),
            now_s=self.now_s,
            deadline_s=self.playout.deadline_s(self.now_s),
            buffer_limit_s=self.playout.limit_s(position),
            request_latency_s=latency_s,
            shown_quality=self._quality(last) if last else None,
            pipelined=self.settings.pipelined and self.connection.pipelines,
            history=self._history(self._sent_s(latency_s)),
        )

    def _options(self, position: int, tiles: Sequence[int] | None = None) -> tuple[Option, ...]:
        """The rungs of the next segment that can be had and are smaller than what was given up."""
        options = self.keys.options(position, tiles)
        if self.given_up[0] == position:
            options = tuple(p for p in options if p.size_bytes < self.given_up[1])
        if self.unusable:
            options = tuple(p for p in options if self._usable(self.keys.missing(position, p.index, tiles)))
        return options

    def _usable(self, batch: Batch) -> bool:
        return self.unusable.isdisjoint(batch.files)

    def _give_up(self, state: PlayerState, decision: Decision) -> GiveUp | None:
        """Abandon a download that, at the rate so far, would come after its deadline, and after the smallest rung
        if that were requested now.
        """
        smallest = min(p.size_bytes for p in state.options)
        if not (self.settings.abandon and self.policy.may_abandon) or smallest >= decision.size_bytes:
            return None
        deadline_s, rtt_s = max(state.deadline_s, self.now_s), self.connection.rtt_s

        def too_late(partial: Partial) -> bool:
            rate = max(partial.bytes, 1.0) / partial.elapsed_s
            left_s = (partial.expected_bytes - partial.bytes) / rate
            return partial.at_s + left_s > deadline_s and left_s > rtt_s + smallest / rate

        return too_late

    def _replace_best(self) -> Fetching[bool]:
        """Fetch the replacement that gains most for its bytes, if any will be in time; False if there is none."""
        if not (self.settings.replace and self.policy.may_replace):
            return False
        estimate_bps = estimate_throughput(self._history(self.now_s))
        best = (
            max(self._replacements(SAFETY * estimate_bps), key=lambda r: r[0], default=None) if estimate_bps else None
        )
        if best is None:
            return False
        _, slot, option = best
        reason = f"{option.quality:.1f} dB in place of {self._quality(slot):.1f}"
        batch, rtt_s = self._replacing(slot, option.index), self.connection.rtt_s
        request = Request(BatchKind.REPLACEMENT, slot.position, option.index, batch, self.now_s, rtt_s)
        arrival = yield from self._receive(request)
        yield Arrived(arrival, Decision(option.index, True, reason, option.size_bytes), 0.0, estimate_bps)
        if arrival.complete and self.now_s + self.settings.decode_frame_s <= slot.start_s:
            yield Replaced(slot.position, slot.rung or 0, option.index)
            self.playout.replace(slot, option.index)
        return True

    def _replacements(self, rate_bps: float) -> Iterator[tuple[float, Slot, Option]]:
        """(dB seconds a byte, segment, rung) of everything that would be better and is expected in time."""
        c = self.catalogue
        for slot in self.playout.pending():
            if not self.now_s < slot.start_s < float("inf"):
                continue
            here, index, level = self._quality(slot), c.index(slot.position), c.rungs[slot.rung or 0][1]
            for option in self.keys.options(slot.position):
                gain = option.quality - (here or 0.0)
                if gain < REPLACE_GAIN_DB:
                    continue
                size = option.size_bytes  # the state is decoded where only the keys would be better
                size -= int(c.state_bytes[index, level]) if c.rungs[option.index][1] == level else 0
                arrival_s = self.now_s + self.connection.rtt_s + 8 * size / rate_bps
                if arrival_s + self.settings.decode_frame_s > slot.start_s:
                    continue
                if not self.unusable or self._usable(self._replacing(slot, option.index)):
                    yield gain * c.seconds_at(slot.position) / max(1, size), slot, option

    def _replacing(self, slot: Slot, rung: int) -> Batch:
        """What it takes to show another rung of a buffered segment: with the same level, only its keys."""
        rungs, batch = self.catalogue.rungs, self.keys.missing(slot.position, rung)
        return Batch(batch.keys) if rungs[rung][1] == rungs[slot.rung or 0][1] else batch

    def _quality(self, slot: Slot) -> float | None:
        """dB, None of a lost segment."""
        return (
            None if slot.rung is None else float(self.catalogue.quality[self.catalogue.index(slot.position), slot.rung])
        )

    def _shown(self, slots: Iterator[Slot]) -> Iterator[Shown]:
        c = self.catalogue
        for slot in slots:
            loop, index = c.place(slot.position)
            start, stop = c.span(index)
            yield Shown(
                segment=index,
                loop=loop,
                rung=slot.rung,
                ready_s=slot.ready_s,
                start_s=slot.start_s,
                frames=stop - start,
                stall_s=slot.stall_s,
                psnr=self._quality(slot) if c.measured else None,
            )
