"""A player: requests, arrivals, choices and what is on the screen, as a stream of events. `run` starts one.

One batch passes at a time: those keyframes of the chosen rung that are not decoded, in tier order, then the delta
segment. A download that would come too late is abandoned when a smaller one would come sooner; whole keyframe files are
decoded all the same. A segment is lost if none of its rungs can be fetched, within the budget of Gaussians: the last
picture stands for its time. When nothing more fits the buffer, a buffered segment may be replaced by a better rung
(with it better keyframes of its group) as long as it arrives in time. The tables of the first segments that the policy
looks at are fetched before the first batch, later ones with the batch before.

A sequence that is played several times is fetched again, but for its tables. One that grows is played as it grows:
airgs.json is fetched again a group's length after the last time, later and later where it has not changed, until it
says that nothing will follow, or nothing has followed for GONE_S; what is over is forgotten. Times are seconds from the
first request.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import partial

from airgs_codec.errors import ConfigError, FormatError, TransportError
from airgs_codec.package.layout import JSON_NAME, POSTER_NAME, FileKind, file_kind, group_path, locate
from airgs_codec.package.tables import PAGE
from airgs_codec.play.downloader import (
    Arrival,
    Arrived,
    BatchKind,
    Cut,
    Displayed,
    Downloader,
    GiveUp,
    Lost,
    Partial,
    Replaced,
    Request,
    Steps,
)  # fmt: skip
from airgs_codec.play.ladder import Decision, Option
from airgs_codec.play.offers import NO_KEYFRAMES, Batch, Keyframe, Keyframes, Offers, SegmentOffer
from airgs_codec.play.playout import Playout, SessionSettings, TimelineEntry
from airgs_codec.play.policies import SAFETY, Coming, Download, PlayerState, Policy, budget_bytes, estimate_throughput

REMEMBERED = 24  # downloads that policies know
NOTHING = Download(0, 1.0)
SHORTEST_S = 1e-9  # a download that rounds to no time still has a rate
POLL_S = 1.0  # airgs.json of a growing package is fetched no more often
LONGEST_POLL_S = 4.0  # and, where it has not changed, no less often, or a group's length if that is longer
GONE_S = 60.0  # without a new group: whoever added groups has gone
MOST_LOST = 1000  # segments in a row
REPLACE_GAIN_DB = 0.5  # least gain that a replacement must bring


def run(offers: Offers, downloader: Downloader, policy: Policy, settings: SessionSettings | None = None) -> Steps[None]:
    """Play a package from the first request to the last picture: the events in the order in which they happen.

    Raises ConfigError where the policy needs quality that was not measured and where all rungs of the first segment are
    over the budget, TransportError when the link fails.
    """
    if policy.needs_quality and not offers.manifest.measured:
        words = "the package has no measured quality, encode it with measure_pictures above 0"
        raise ConfigError(f"policy {policy.name}: {words}")
    rules = settings or SessionSettings()
    return Player(offers, downloader, policy, rules, Playout(rules), TableStore(offers)).play()


@dataclass(slots=True, eq=False)
class TableStore:
    """The tables that have come: pages of the index and tables of groups are fetched once, whatever is played again."""

    offers: Offers
    first: int = 0  # the segment before which nothing is played any more
    _paths: set[str] = field(default_factory=set)

    def add(self, arrival: Arrival) -> None:
        self._paths.update(path for path in arrival.usable if file_kind(path) in (FileKind.MANIFESTS, FileKind.POSTER))

    def has(self, position: int) -> bool:
        return self._next(self.offers.place(position)[1]) is None

    def missing(self, positions: range) -> tuple[str, ...]:
        poster = POSTER_NAME if self.offers.manifest.poster and POSTER_NAME not in self._paths else None
        wanted = dict.fromkeys([poster, *(self._next(self.offers.place(position)[1]) for position in positions)])
        return tuple(path for path in wanted if path is not None)

    def missing_pages(self, position: int) -> tuple[str, ...]:
        """Return the missing pages of the index that list segments still to be played, up to a position."""
        segments = range(max(self.first, self.offers.first), self.offers.first + position + 1)
        return tuple(self.offers.manifest.groups.places.missing_pages(segments, self._paths))

    def forget(self, before: SegmentOffer) -> None:
        """Drop what is known of groups before a segment, which are not played again."""
        self.first = before.segment
        self._paths = {path for path in self._paths if not _is_past(path, before)}

    def _next(self, segment: int) -> str | None:
        return next((path for path in self._way(segment) if path not in self._paths), None)

    def _way(self, segment: int) -> Iterator[str]:
        """Yield pages and tables that lead to a segment; each is read when the next one is asked for."""
        groups = self.offers.manifest.groups
        yield from groups.places.pages_to("segments", segment)
        group = groups.places.at_segment(segment)
        yield group_path(group + 1)
        base = groups[group].base
        if base is not None:
            yield from groups.places.pages_to("groups", base - 1)
            yield group_path(base)


def _is_past(path: str, before: SegmentOffer) -> bool:
    """Return whether a page or table describes only groups before a segment's group, and not its base."""
    what, numbers = locate(path)
    if what not in ("group", "page"):
        return False
    size = 1 if what == "group" else PAGE ** numbers[0]
    groups = range((numbers[-1] - 1) * size, numbers[-1] * size)
    return groups.stop <= before.group and before.base not in groups


@dataclass(slots=True, eq=False)
class Player:
    offers: Offers
    downloader: Downloader
    policy: Policy
    settings: SessionSettings
    playout: Playout
    tables: TableStore
    end: int = 0  # positions, so far where the package grows
    now_s: float = 0.0  # when the last batch was over, or when there was room for the next
    root_s: float = 0.0  # when airgs.json was asked for
    lost: int = 0  # positions in a row
    downloads: list[tuple[float, Download]] = field(default_factory=list)  # with their arrivals
    first: Download = NOTHING  # the fastest of tables and poster, the wait for its first byte included
    unusable: set[str] = field(default_factory=set)  # files found missing or corrupt
    given_up: tuple[int, int] = (-1, 0)  # position and size: nothing as large is asked for at that position again
    _keyframes: dict[int, set[Keyframe]] = field(default_factory=dict)  # decoded, by loop: each fetches its own

    def play(self) -> Steps[None]:
        offers, position = self.offers, 0
        yield from self._fetch_root(0)
        self.end = offers.end(offers.loops(self.settings.loops))
        while position < self.end or (yield from self._grow(position)):
            while wanted := self.wanted_tables(range(position, self.end)):
                yield from self.fetch_tables(wanted, position)
            if not position:
                offers.check_budget([offers.first], self.settings.budget)
            earliest_s = self.playout.make_room(offers.seconds_at(position))
            yield from self._improve_buffered(earliest_s)
            latency_s = self.latency_s(earliest_s) if position else self.downloader.rtt_s
            self.now_s = max(self.now_s, earliest_s)
            yield from self._fetch_next(position, latency_s)
            yield from self._shown(self.playout.started(self.now_s))
            position += 1
            if self.lost == MOST_LOST:  # an index may promise more than anybody can wait for
                yield Cut(self.now_s, f"{MOST_LOST} segments in a row were lost")
                self.playout.resume(self.now_s)
                break
        yield from self._improve_buffered(math.inf)
        yield from self._shown(self.playout.started())

    def _grow(self, position: int) -> Steps[bool]:
        """Wait until a growing package has a segment for a position; returns False if it ends before."""
        offers, since_s, in_vain = self.offers, self.now_s, 0
        while offers.live and offers.end(1) <= position:
            if self.now_s >= since_s + GONE_S:
                yield Cut(self.now_s, f"no group has followed for {GONE_S:g} s")
                break
            newest = offers.manifest.groups.places.entry(len(offers.manifest.groups) - 1)
            pause_s = max(POLL_S, (newest.stop - newest.start) / offers.fps)
            ask_s = max(self.now_s, self.root_s + max(pause_s, min(pause_s * 2 ** (in_vain - 1), LONGEST_POLL_S)))
            yield from self._improve_buffered(ask_s)
            self.now_s = max(self.now_s, ask_s)
            yield from self._shown(self.playout.started(self.now_s))
            yield from self._fetch_root(position)
            in_vain += 1
        oldest = self.playout.forget(self.now_s)
        if oldest is not None and (before := oldest.offer) is not None:
            self.tables.forget(before)
            still_used, loop = (before.base, before.group), self.loop(oldest.position)
            self._keyframes[loop] = {key for key in self.decoded(loop) if key[0] in still_used or key[0] > before.group}
        if offers.end(1) > position:
            self.end = offers.end(1)
            return True
        self.playout.resume(self.now_s)
        return False

    def _fetch_root(self, position: int) -> Steps[None]:
        """Fetch airgs.json, and pages to which a growing package has moved entries of its root."""
        self.root_s = self.now_s
        yield from self.fetch_tables((JSON_NAME,), position)
        while (position or self.offers.live) and (pages := self.tables.missing_pages(position)):
            yield from self.fetch_tables(pages, position)
            if not self.unusable.isdisjoint(pages):
                raise TransportError(f"{', '.join(pages)}: expected the index of the growing package")

    def _fetch_next(self, position: int, latency_s: float) -> Steps[None]:
        slot: TimelineEntry | None = None
        if self.tables.has(position):
            while (state := self._state(position, latency_s)).options:
                decision = self.policy.decide(state)
                if (yield from self._fetch(state, decision)):
                    ready_s = self.now_s + self.settings.decode_frame_s
                    slot = TimelineEntry(position, state.segment_s, ready_s, state.offer, decision.index)
                    break
                latency_s = self.downloader.rtt_s
        self.lost = 0 if slot else self.lost + 1
        if slot is None:
            yield Lost(position, self.now_s)
            slot = TimelineEntry(position, self.offers.seconds_at(position), self.now_s)
        self.playout.enqueue(slot, position == self.end - 1 and not self.offers.live)

    def _fetch(self, state: PlayerState, decision: Decision) -> Steps[bool]:
        """Fetch the chosen rung; returns False if it was abandoned or files were refused."""
        position, rung = state.position, decision.index
        ahead = self.wanted_tables(range(position + 1, self.end)) if position else ()  # nothing delays the first
        batch = replace(self.missing(position, rung), tables=ahead)
        if not batch.files:  # nothing moves: the canonical space is decoded
            return True
        kind = BatchKind.GROUP if batch.keyframes else BatchKind.DELTA
        request = Request(kind, position, rung, batch, self.sent_s(state.request_latency_s), state.request_latency_s)
        size = next(o.size_bytes for o in state.options if o.index == rung)
        give_up = self.give_up(state.deadline_s, size, min(o.size_bytes for o in state.options))
        arrival = self.receive(request, give_up)
        yield Arrived(arrival, decision, budget_bytes(state), state.throughput_bps)
        if arrival.abandoned:
            self.given_up = position, size
        return arrival.complete

    def _state(self, position: int, latency_s: float) -> PlayerState:
        timeline, upcoming = self.playout.timeline, partial(self.upcoming, range(position, self.end))
        offers = self.offer(position), upcoming, self.decoded(self.loop(position)), self.choices(position)
        times = self.now_s, self.playout.deadline_s(self.now_s), self.settings.buffer_s, latency_s
        shown, history = timeline[-1].psnr if timeline else None, self.history(self.sent_s(latency_s))
        return PlayerState(position, *offers, *times, self.pipelines, shown, history)

    def _shown(self, slots: Iterator[TimelineEntry]) -> Iterator[Displayed]:
        for slot in slots:
            loop, segment = self.offers.place(slot.position)
            start, stop = self.offers.span(segment)
            rung = None if slot.offer is None else slot.rung
            psnr = slot.psnr if self.offers.manifest.measured else None
            yield Displayed(segment, loop, rung, slot.ready_s, slot.start_s, stop - start, slot.stall_s, psnr)

    def _improve_buffered(self, until_s: float) -> Steps[None]:
        """Fetch better rungs of buffered segments until a moment, the largest gain for its bytes first."""
        while self.now_s < until_s and self.settings.replace and self.policy.may_replace:
            estimate_bps = estimate_throughput(self.history(self.now_s))
            replacements = self._replacements(SAFETY * estimate_bps) if estimate_bps else ()
            best = max(replacements, key=lambda r: r[0], default=None)
            if best is None:
                return
            _, slot, option = best
            reason = f"{option.quality:.1f} dB in place of {slot.psnr:.1f}"
            batch, rtt_s = self._replacing(slot, option.index), self.downloader.rtt_s
            request = Request(BatchKind.REPLACEMENT, slot.position, option.index, batch, self.now_s, rtt_s)
            arrival = self.receive(request)
            yield Arrived(arrival, Decision(option.index, True, reason, option.size_bytes), 0.0, estimate_bps)
            if arrival.complete and self.now_s + self.settings.decode_frame_s <= slot.start_s:
                yield Replaced(slot.position, slot.rung, option.index)
                slot.rung = option.index

    def _replacements(self, rate_bps: float) -> Iterator[tuple[float, TimelineEntry, Option]]:
        """Yield (dB seconds per byte, segment, rung) of every better rung that is expected in time."""
        free_s = self.now_s + self.downloader.rtt_s
        for slot, offer in self.playout.pending():
            if not self.now_s < slot.start_s < math.inf:
                continue
            here = offer.rungs[slot.rung]
            for option in self.options(slot.position):
                gain = option.quality - here.psnr
                if gain < REPLACE_GAIN_DB:
                    continue
                size = option.size_bytes  # the delta is decoded where only the keyframes would be better
                size -= here.delta_bytes if offer.rungs[option.index].level == here.level else 0
                if free_s + 8 * size / rate_bps + self.settings.decode_frame_s > slot.start_s:
                    continue
                if not self.unusable or self.unusable.isdisjoint(self._replacing(slot, option.index).files):
                    yield gain * slot.seconds / max(1, size), slot, option

    def _replacing(self, slot: TimelineEntry, rung: int) -> Batch:
        """Return the files for another rung of a buffered segment; only keyframes if its level stays."""
        offer, batch = self.offer(slot.position), self.missing(slot.position, rung)
        return Batch(batch.keyframes) if offer.rungs[rung].level == offer.rungs[slot.rung].level else batch

    def _use_keyframes(self, request: Request) -> None:
        """Give buffered segments of the same group the quality of new keyframes, if decoded in time."""
        loop, here = self.loop(request.position), self.offer(request.position)
        quality, ready_s = here.rungs[request.rung].quality, self.now_s + self.settings.decode_frame_s
        for slot, offer in self.playout.pending():
            if slot.start_s < ready_s or offer.group != here.group or self.loop(slot.position) != loop:
                continue
            better = quality * len(offer.levels) + offer.rungs[slot.rung].level
            if better < slot.rung and all(of.keyframe in self.decoded(loop) for of in offer.rungs[better].keyframes):
                slot.rung = better

    def loop(self, position: int) -> int:
        return self.offers.place(position)[0]

    def offer(self, position: int) -> SegmentOffer:
        return self.offers.offer(self.offers.place(position)[1], self.settings.budget)

    def decoded(self, loop: int) -> Keyframes:
        return self._keyframes.get(loop, NO_KEYFRAMES)

    def upcoming(self, positions: range) -> Iterator[Coming]:
        """Yield the offers of positions until a table is missing, each with the keyframes decoded in its loop."""
        for position in positions:
            try:
                offer = self.offer(position)
            except FormatError:
                return
            yield offer, self.decoded(self.loop(position))

    def wanted_tables(self, positions: range) -> tuple[str, ...]:
        """Return the missing tables that the policy needs at the first of these positions, unless they are unusable."""
        reach = positions[: self.policy.horizon]
        return tuple(path for path in self.tables.missing(reach) if path not in self.unusable)

    def fetch_tables(self, paths: tuple[str, ...], position: int) -> Iterator[Arrived]:
        request = Request(BatchKind.TABLES, position, 0, Batch(tables=paths), self.now_s, self.downloader.rtt_s)
        arrival = self.receive(request)
        yield Arrived(arrival, Decision(0, True, "tables", arrival.bytes), 0.0, 0.0)

    def receive(self, request: Request, give_up: GiveUp | None = None) -> Arrival:
        """Fetch a batch and store what can be used. Sound that cannot be had is silence: it counts as decoded."""
        arrival = self.downloader.fetch(request, give_up)
        self.now_s = arrival.at_s
        silent = {path for path in arrival.refused if file_kind(path) is FileKind.SOUND}
        self.unusable.update(arrival.refused.keys() - silent)
        self.tables.add(arrival)
        if request.kind is BatchKind.TABLES:  # in one burst, too short to tell the rate, but not that it is no less
            took_s = max(arrival.at_s - request.sent_s, SHORTEST_S)
            self.first = max(self.first, Download(arrival.bytes, took_s), key=lambda d: d.bytes / d.seconds)
        else:
            took_s = max(arrival.at_s - arrival.first_byte_s, SHORTEST_S)
            self.downloads = [*self.downloads[1 - REMEMBERED :], (arrival.at_s, Download(arrival.bytes, took_s))]
            arrived = silent.union(arrival.usable)
            needed = self.offer(request.position).rungs[request.rung].keyframes
            decoded = self._keyframes.setdefault(self.loop(request.position), set())
            decoded.update(of.keyframe for of in needed if arrived.issuperset(of.files))
            self._use_keyframes(request)
        return arrival

    @property
    def pipelines(self) -> bool:
        return self.settings.pipelined and self.downloader.pipelines

    def latency_s(self, earliest_s: float) -> float:
        """Return the remaining latency once the link is idle; with pipelining part of it has already passed."""
        rtt_s = self.downloader.rtt_s
        return max(0.0, rtt_s - (self.now_s - earliest_s)) if self.pipelines and earliest_s < self.now_s else rtt_s

    def sent_s(self, latency_s: float) -> float:
        """Return when a request was sent that has this much latency left now."""
        return self.now_s - (self.downloader.rtt_s - latency_s)

    def history(self, sent_s: float) -> tuple[Download, ...]:
        """Return the last downloads finished by `sent_s`, oldest first; before there is one, that of the tables."""
        return tuple(d for at_s, d in self.downloads if at_s <= sent_s + SHORTEST_S) or (self.first,)

    def missing(self, position: int, rung: int) -> Batch:
        return self.offer(position).missing(rung, self.decoded(self.loop(position)))

    def options(self, position: int) -> tuple[Option, ...]:
        return self.offer(position).options(self.decoded(self.loop(position)))

    def choices(self, position: int) -> tuple[Option, ...]:
        """Return the rungs at a position that can be fetched and are smaller than one abandoned before."""
        options = self.options(position)
        if self.unusable:
            options = tuple(p for p in options if self.unusable.isdisjoint(self.missing(position, p.index).files))
        return tuple(p for p in options if self.given_up[0] != position or p.size_bytes < self.given_up[1])

    def give_up(self, deadline_s: float, size: int, smallest: int) -> GiveUp | None:
        """Return when to abandon a download: at the rate so far it would come after its deadline, and after the
        smallest rung if that were requested now.
        """
        if not (self.settings.abandon and self.policy.may_abandon) or smallest >= size:
            return None
        due_s, rtt_s = max(deadline_s, self.now_s), self.downloader.rtt_s

        def too_late(partial: Partial) -> bool:
            rate = max(partial.bytes, 1.0) / partial.elapsed_s  # bytes a second so far
            left_s = (partial.expected_bytes - partial.bytes) / rate
            return partial.at_s + left_s > due_s and left_s > rtt_s + smallest / rate

        return too_late
