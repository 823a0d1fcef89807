"""A player: requests, arrivals, choices and what is on the screen, as a stream of events. `run` starts one.

One batch passes at a time: those keys of the chosen rung that are not decoded, in tier order, then the state segment. A
download that would come too late is abandoned when a smaller one would come sooner; whole key files that have arrived
are decoded. A segment none of whose rungs can be had is lost: the last picture stands for its time, and the session
goes on.

What a batch offers stands in the table of its group: those of the first segments that the policy looks at are fetched
before the first batch, later ones with the batch before. A segment whose table cannot be had is lost. Rungs that show
more Gaussians than the budget are as if they could not be had.

The sequence may be played several times, as if it were longer: keys and states are fetched again, tables are not. One
that grows is played as it grows: airgs.json is fetched again a group's length after the last time, later and later
where it has not changed, until it says that nothing will follow, or nothing has followed for SILENCE_S; what is over
is forgotten. Times are seconds from the first request.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import partial

from airgs_codec.errors import ConfigError, TransportError
from airgs_codec.package.layout import JSON_NAME
from airgs_codec.play.buffered import Buffered
from airgs_codec.play.downloader import (
    Arrived,
    BatchKind,
    Connection,
    Cut,
    Downloader,
    Event,
    Fetching,
    Lost,
    Request,
    Shown,
    Steps,
    answer,
)
from airgs_codec.play.fetcher import Fetcher
from airgs_codec.play.ladder import Decision
from airgs_codec.play.offers import Offers
from airgs_codec.play.playout import Playout, Slot
from airgs_codec.play.policies.state import PlayerState, Policy, budget_bytes, estimate_throughput
from airgs_codec.play.settings import SessionSettings

POLL_S = 1.0  # airgs.json of a growing package is fetched no more often
LONGEST_POLL_S = 4.0  # and, where it has not changed, no less often, or a group's length if that is longer
SILENCE_S = 60.0  # without a new group: whoever added groups has gone
MOST_LOST = 1000  # segments in a row


def run(
    offers: Offers, downloader: Downloader, policy: Policy, settings: SessionSettings | None = None
) -> Iterator[Event]:
    """Play a package from the first request to the last picture.

    Raises ConfigError where the policy needs quality that was not measured and where all rungs of the first segment are
    over the budget, TransportError when the link fails.
    """
    return answer(play_steps(offers, downloader, policy, settings), downloader)


def play_steps(
    offers: Offers, connection: Connection, policy: Policy, settings: SessionSettings | None = None
) -> Steps:
    """The same as steps of a player that fetches nothing itself: whoever runs it sends the arrival of every `Wanted`,
    and None after every event, so that many players can share one thread.

    Raises ConfigError where the policy needs quality that was not measured.
    """
    if policy.needs_quality and not offers.manifest.measured:
        raise ConfigError(
            f"policy {policy.name}: the package has no measured quality, encode it with measure_pictures above 0"
        )
    rules = settings or SessionSettings()
    return Player(Fetcher(offers, connection, policy, rules), Playout(rules)).play()


@dataclass(slots=True, eq=False)
class Player:
    fetcher: Fetcher
    playout: Playout
    end: int = 0  # positions, so far where the package grows
    root_s: float = 0.0  # when airgs.json was asked for
    lost: int = 0  # positions in a row
    buffered: Buffered = field(init=False)

    def __post_init__(self) -> None:
        self.buffered = Buffered(self.fetcher, self.playout)

    def play(self) -> Steps:
        """All events of the session, in the order in which they happen."""
        f, offers, position = self.fetcher, self.fetcher.offers, 0
        yield from self._fetch_root(0)
        self.end = offers.end(offers.loops(f.settings.loops))
        while position < self.end or (yield from self._grow(position)):
            while wanted := f.wanted_tables(range(position, self.end)):
                yield from f.fetch_tables(wanted, position)
            if not position:
                offers.check_budget([offers.first], f.settings.budget)
            seconds = offers.seconds_at(position)
            self.playout.make_room(seconds)
            earliest_s = self.playout.earliest_request_s(seconds)
            yield from self.buffered.wait(earliest_s)
            latency_s = f.latency_s(earliest_s) if position else f.connection.rtt_s
            f.now_s = max(f.now_s, earliest_s)
            yield from self._fetch_next(position, earliest_s, latency_s)
            yield from self._shown(self.playout.started(f.now_s))
            position += 1
            if self.lost == MOST_LOST:  # an index may promise more than anybody can wait for
                yield Cut(f.now_s, f"{MOST_LOST} segments in a row were lost")
                self.playout.finish(f.now_s)
                break
        yield from self.buffered.wait(math.inf)
        yield from self._shown(self.playout.started())

    def _grow(self, position: int) -> Fetching[bool]:
        """Wait until a growing package has a segment for a position; False: it has ended before."""
        f, offers, since_s, in_vain = self.fetcher, self.fetcher.offers, self.fetcher.now_s, 0
        while offers.live and offers.end(1) <= position:
            if f.now_s >= since_s + SILENCE_S:
                yield Cut(f.now_s, f"no group has followed for {SILENCE_S:g} s")
                break
            pause_s = max(POLL_S, offers.newest_seconds)
            ask_s = max(f.now_s, self.root_s + max(pause_s, min(pause_s * 2 ** (in_vain - 1), LONGEST_POLL_S)))
            yield from self.buffered.wait(ask_s)
            f.now_s = max(f.now_s, ask_s)
            yield from self._shown(self.playout.started(f.now_s))
            yield from self._fetch_root(position)
            in_vain += 1
        oldest = self.playout.forget(f.now_s)
        if oldest is not None and oldest.offer is not None:
            f.forget(oldest.position, oldest.offer)
        if offers.end(1) > position:
            self.end = offers.end(1)
            return True
        self.playout.finish(f.now_s)
        return False

    def _fetch_root(self, position: int) -> Steps:
        """Fetch airgs.json, and, as a package grows, the pages that now say what the root said before."""
        f = self.fetcher
        self.root_s = f.now_s
        yield from f.fetch_tables((JSON_NAME,), position)
        while (position or f.offers.live) and (pages := f.tables.missing_pages(position)):
            yield from f.fetch_tables(pages, position)
            if not f.unusable.isdisjoint(pages):
                raise TransportError(f"{', '.join(pages)}: expected the index of the growing package")

    def _fetch_next(self, position: int, earliest_s: float, latency_s: float) -> Steps:
        """Fetch the next segment, and put it on the timeline."""
        f = self.fetcher
        rung: int | None = None
        if f.tables.has(position):
            while (state := self._state(position, latency_s)).options:
                decision = f.policy.decide(state)
                if (yield from self._fetch(state, decision)):
                    rung = decision.index
                    break
                latency_s = f.connection.rtt_s
        ready_s = f.now_s + f.settings.decode_frame_s
        self.lost = self.lost + 1 if rung is None else 0
        if rung is None:
            yield Lost(position, f.now_s)
            slot = Slot(position, f.offers.seconds_at(position), f.now_s)
        else:
            offer = f.offer(position)
            slot = Slot(position, offer.seconds, ready_s, offer, rung)
        self.playout.enqueue(slot, position == self.end - 1 and not f.offers.live)

    def _fetch(self, state: PlayerState, decision: Decision) -> Fetching[bool]:
        """Fetch what was decided; False: it was abandoned or broken."""
        f, position, rung = self.fetcher, state.position, decision.index
        ahead = f.wanted_tables(range(position + 1, self.end)) if position else ()  # nothing delays the first picture
        batch = replace(f.missing(position, rung), tables=ahead)
        if not batch.files:  # nothing moves: the canonical space is decoded
            return True
        kind = BatchKind.GROUP if batch.keys else BatchKind.STATE
        request = Request(kind, position, rung, batch, f.sent_s(state.request_latency_s), state.request_latency_s)
        size = next(o.size_bytes for o in state.options if o.index == rung)
        give_up = f.give_up(state.deadline_s, size, min(o.size_bytes for o in state.options))
        arrival = yield from f.receive(request, give_up)
        self.buffered.use_keys(request)
        yield Arrived(arrival, decision, budget_bytes(state), estimate_throughput(state.history))
        if arrival.abandoned:
            f.given_up = position, size
        return arrival.complete

    def _state(self, position: int, latency_s: float) -> PlayerState:
        """Return what is known before a segment is requested."""
        f, last = self.fetcher, self.playout.last
        return PlayerState(
            position=position,
            offer=f.offer(position),
            upcoming=partial(f.upcoming, range(position, self.end)),
            decoded=f.keys.decoded(f.loop(position)),
            options=f.choices(position),
            now_s=f.now_s,
            deadline_s=self.playout.deadline_s(f.now_s),
            buffer_limit_s=f.settings.buffer_s,
            request_latency_s=latency_s,
            shown_quality=last.psnr if last else None,
            pipelined=f.pipelines,
            history=f.history(f.sent_s(latency_s)),
        )

    def _shown(self, slots: Iterator[Slot]) -> Iterator[Shown]:
        offers = self.fetcher.offers
        for slot in slots:
            loop, segment = offers.place(slot.position)
            start, stop = offers.span(segment)
            yield Shown(
                segment=segment,
                loop=loop,
                rung=None if slot.offer is None else slot.rung,
                ready_s=slot.ready_s,
                start_s=slot.start_s,
                frames=stop - start,
                stall_s=slot.stall_s,
                psnr=slot.psnr if offers.manifest.measured else None,
            )
