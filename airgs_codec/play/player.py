"""A player: requests, arrivals, choices and what is on the screen, as a stream of events. `run` starts one.

One batch passes at a time: those keyframes of the chosen rung that are not decoded, in tier order, then the delta
segment. A download that would come too late is abandoned when a smaller one would come sooner; whole keyframe files
that have arrived are decoded. A segment none of whose rungs can be had is lost: the last picture stands for its time,
and the session goes on. When nothing more fits the buffer, a buffered segment may be replaced by a better rung (with it
better keyframes of its group) as long as it will be there in time.

What a batch offers stands in the table of its group: those of the first segments that the policy looks at are fetched
before the first batch, later ones with the batch before. A segment whose table cannot be had is lost. Rungs that show
more Gaussians than the budget are as if they could not be had.

The sequence may be played several times, as if it were longer: keyframes and deltas are fetched again, tables are not.
One that grows is played as it grows: airgs.json is fetched again a group's length after the last time, later and later
where it has not changed, until it says that nothing will follow, or nothing has followed for SILENCE_S; what is over
is forgotten. Times are seconds from the first request.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

from airgs_codec.errors import ConfigError, TransportError
from airgs_codec.package.layout import JSON_NAME
from airgs_codec.play.downloader import Arrived, BatchKind, Cut, Downloader, Lost, Replaced, Request, Shown, Steps
from airgs_codec.play.fetcher import Fetcher
from airgs_codec.play.ladder import Decision, Option
from airgs_codec.play.offers import Batch, Offers
from airgs_codec.play.playout import Playout, SessionSettings, Slot
from airgs_codec.play.policies import SAFETY, PlayerState, Policy, budget_bytes, estimate_throughput

POLL_S = 1.0  # airgs.json of a growing package is fetched no more often
LONGEST_POLL_S = 4.0  # and, where it has not changed, no less often, or a group's length if that is longer
SILENCE_S = 60.0  # without a new group: whoever added groups has gone
MOST_LOST = 1000  # segments in a row
REPLACE_GAIN_DB = 0.5  # least gain that a replacement must bring


def run(offers: Offers, downloader: Downloader, policy: Policy, settings: SessionSettings | None = None) -> Steps[None]:
    """Play a package from the first request to the last picture: the events in the order in which they happen.

    Raises ConfigError where the policy needs quality that was not measured and where all rungs of the first segment are
    over the budget, TransportError when the link fails.
    """
    if policy.needs_quality and not offers.manifest.measured:
        raise ConfigError(
            f"policy {policy.name}: the package has no measured quality, encode it with measure_pictures above 0"
        )
    rules = settings or SessionSettings()
    return Player(Fetcher(offers, downloader, policy, rules), Playout(rules)).play()


@dataclass(slots=True, eq=False)
class Player:
    fetcher: Fetcher
    playout: Playout
    end: int = 0  # positions, so far where the package grows
    root_s: float = 0.0  # when airgs.json was asked for
    lost: int = 0  # positions in a row

    def play(self) -> Steps[None]:
        f, offers, position = self.fetcher, self.fetcher.offers, 0
        yield from self._fetch_root(0)
        self.end = offers.end(offers.loops(f.settings.loops))
        while position < self.end or (yield from self._grow(position)):
            while wanted := f.wanted_tables(range(position, self.end)):
                yield from f.fetch_tables(wanted, position)
            if not position:
                offers.check_budget([offers.first], f.settings.budget)
            earliest_s = self.playout.make_room(offers.seconds_at(position))
            yield from self._improve_buffered(earliest_s)
            latency_s = f.latency_s(earliest_s) if position else f.downloader.rtt_s
            f.now_s = max(f.now_s, earliest_s)
            yield from self._fetch_next(position, latency_s)
            yield from self._shown(self.playout.started(f.now_s))
            position += 1
            if self.lost == MOST_LOST:  # an index may promise more than anybody can wait for
                yield Cut(f.now_s, f"{MOST_LOST} segments in a row were lost")
                self.playout.resume(f.now_s)
                break
        yield from self._improve_buffered(math.inf)
        yield from self._shown(self.playout.started())

    def _grow(self, position: int) -> Steps[bool]:
        """Wait until a growing package has a segment for a position; returns False if it ends before."""
        f, offers, since_s, in_vain = self.fetcher, self.fetcher.offers, self.fetcher.now_s, 0
        while offers.live and offers.end(1) <= position:
            if f.now_s >= since_s + SILENCE_S:
                yield Cut(f.now_s, f"no group has followed for {SILENCE_S:g} s")
                break
            newest = offers.manifest.groups.places.entry(len(offers.manifest.groups) - 1)
            pause_s = max(POLL_S, (newest.stop - newest.start) / offers.fps)
            ask_s = max(f.now_s, self.root_s + max(pause_s, min(pause_s * 2 ** (in_vain - 1), LONGEST_POLL_S)))
            yield from self._improve_buffered(ask_s)
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
        self.playout.resume(f.now_s)
        return False

    def _fetch_root(self, position: int) -> Steps[None]:
        """Fetch airgs.json, and pages to which a growing package has moved entries of its root."""
        f = self.fetcher
        self.root_s = f.now_s
        yield from f.fetch_tables((JSON_NAME,), position)
        while (position or f.offers.live) and (pages := f.tables.missing_pages(position)):
            yield from f.fetch_tables(pages, position)
            if not f.unusable.isdisjoint(pages):
                raise TransportError(f"{', '.join(pages)}: expected the index of the growing package")

    def _fetch_next(self, position: int, latency_s: float) -> Steps[None]:
        """Fetch the next segment, and put it on the timeline."""
        f = self.fetcher
        slot: Slot | None = None
        if f.tables.has(position):
            while (state := self._state(position, latency_s)).options:
                decision = f.policy.decide(state)
                if (yield from self._fetch(state, decision)):
                    ready_s = f.now_s + f.settings.decode_frame_s
                    slot = Slot(position, state.segment_s, ready_s, state.offer, decision.index)
                    break
                latency_s = f.downloader.rtt_s
        self.lost = 0 if slot else self.lost + 1
        if slot is None:
            yield Lost(position, f.now_s)
            slot = Slot(position, f.offers.seconds_at(position), f.now_s)
        self.playout.enqueue(slot, position == self.end - 1 and not f.offers.live)

    def _fetch(self, state: PlayerState, decision: Decision) -> Steps[bool]:
        """Fetch the chosen rung; returns False if it was abandoned or files were refused."""
        f, position, rung = self.fetcher, state.position, decision.index
        ahead = f.wanted_tables(range(position + 1, self.end)) if position else ()  # nothing delays the first picture
        batch = replace(f.missing(position, rung), tables=ahead)
        if not batch.files:  # nothing moves: the canonical space is decoded
            return True
        kind = BatchKind.GROUP if batch.keyframes else BatchKind.DELTA
        request = Request(kind, position, rung, batch, f.sent_s(state.request_latency_s), state.request_latency_s)
        size = next(o.size_bytes for o in state.options if o.index == rung)
        give_up = f.give_up(state.deadline_s, size, min(o.size_bytes for o in state.options))
        arrival = f.receive(request, give_up)
        self._use_keyframes(request)
        yield Arrived(arrival, decision, budget_bytes(state), state.throughput_bps)
        if arrival.abandoned:
            f.given_up = position, size
        return arrival.complete

    def _state(self, position: int, latency_s: float) -> PlayerState:
        f, timeline = self.fetcher, self.playout.timeline
        return PlayerState(
            position=position,
            offer=f.offer(position),
            upcoming=partial(f.upcoming, range(position, self.end)),
            decoded=f.decoded(f.loop(position)),
            options=f.choices(position),
            now_s=f.now_s,
            deadline_s=self.playout.deadline_s(f.now_s),
            buffer_limit_s=f.settings.buffer_s,
            request_latency_s=latency_s,
            shown_quality=timeline[-1].psnr if timeline else None,
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

    def _improve_buffered(self, until_s: float) -> Steps[None]:
        """Fetch better rungs of buffered segments until a moment, the largest gain for its bytes first."""
        f = self.fetcher
        while f.now_s < until_s and f.settings.replace and f.policy.may_replace:
            estimate_bps = estimate_throughput(f.history(f.now_s))
            replacements = self._replacements(SAFETY * estimate_bps) if estimate_bps else ()
            best = max(replacements, key=lambda r: r[0], default=None)
            if best is None:
                return
            _, slot, option = best
            reason = f"{option.quality:.1f} dB in place of {slot.psnr:.1f}"
            batch, rtt_s = self._replacing(slot, option.index), f.downloader.rtt_s
            request = Request(BatchKind.REPLACEMENT, slot.position, option.index, batch, f.now_s, rtt_s)
            arrival = f.receive(request)
            self._use_keyframes(request)
            yield Arrived(arrival, Decision(option.index, True, reason, option.size_bytes), 0.0, estimate_bps)
            if arrival.complete and f.now_s + f.settings.decode_frame_s <= slot.start_s:
                yield Replaced(slot.position, slot.rung, option.index)
                slot.rung = option.index

    def _replacements(self, rate_bps: float) -> Iterator[tuple[float, Slot, Option]]:
        """Yield (dB seconds per byte, segment, rung) of every better rung that is expected in time."""
        f = self.fetcher
        free_s = f.now_s + f.downloader.rtt_s
        for slot, offer in self.playout.pending():
            if not f.now_s < slot.start_s < math.inf:
                continue
            here = offer.rungs[slot.rung]
            for option in f.options(slot.position):
                gain = option.quality - here.psnr
                if gain < REPLACE_GAIN_DB:
                    continue
                size = option.size_bytes  # the state is decoded where only the keyframes would be better
                size -= here.delta_bytes if offer.rungs[option.index].level == here.level else 0
                if free_s + 8 * size / rate_bps + f.settings.decode_frame_s > slot.start_s:
                    continue
                if not f.unusable or f.unusable.isdisjoint(self._replacing(slot, option.index).files):
                    yield gain * slot.seconds / max(1, size), slot, option

    def _replacing(self, slot: Slot, rung: int) -> Batch:
        """Return the files for another rung of a buffered segment; only keyframes if its level stays."""
        offer, batch = self.fetcher.offer(slot.position), self.fetcher.missing(slot.position, rung)
        return Batch(batch.keyframes) if offer.rungs[rung].level == offer.rungs[slot.rung].level else batch

    def _use_keyframes(self, request: Request) -> None:
        """Give buffered segments of the same group the quality of new keyframes, if decoded in time."""
        f = self.fetcher
        loop, here = f.loop(request.position), f.offer(request.position)
        quality, ready_s = here.rungs[request.rung].quality, f.now_s + f.settings.decode_frame_s
        for slot, offer in self.playout.pending():
            if slot.start_s < ready_s or offer.group != here.group or f.loop(slot.position) != loop:
                continue
            better = quality * len(offer.levels) + offer.rungs[slot.rung].level
            if better < slot.rung and all(of.keyframe in f.decoded(loop) for of in offer.rungs[better].keyframes):
                slot.rung = better
