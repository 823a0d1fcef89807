"""What is made of the time that a player waits: better rungs of what is buffered.

When nothing more fits the buffer, a buffered segment may be replaced by a better rung (with it better keys of its
group) as long as it will be there in time.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from airgs_codec.play.downloader import Arrived, BatchKind, Fetching, Replaced, Request, Steps
from airgs_codec.play.fetcher import Fetcher
from airgs_codec.play.ladder import Decision, Option
from airgs_codec.play.offers import Batch
from airgs_codec.play.playout import Playout, Slot
from airgs_codec.play.policies.state import SAFETY

REPLACE_GAIN_DB = 0.5  # least gain that a replacement must bring


@dataclass(slots=True, eq=False)
class Buffered:
    """What a session has buffered, to be made better."""

    fetcher: Fetcher
    playout: Playout

    def wait(self, until_s: float) -> Steps:
        """Spend the time until the next request, or all that is left, on what is buffered."""
        while self.fetcher.now_s < until_s and (yield from self._replace_best()):
            pass

    def use_keys(self, request: Request) -> None:
        """Show what is buffered of a group with its best keys, where they are decoded in time."""
        f = self.fetcher
        loop, here = f.loop(request.position), f.offer(request.position)
        quality, ready_s = here.rungs[request.rung].quality, f.now_s + f.settings.decode_frame_s
        for slot, offer in self.playout.pending():
            if slot.start_s < ready_s or offer.group != here.group or f.loop(slot.position) != loop:
                continue
            better = offer.with_keys(slot.rung, quality)
            if better < slot.rung and f.keys.shows(loop, offer, better):
                slot.rung = better

    def _replace_best(self) -> Fetching[bool]:
        """Fetch the replacement that gains most for its bytes, if any will be in time; False if there is none."""
        f = self.fetcher
        if not (f.settings.replace and f.policy.may_replace):
            return False
        estimate_bps = f.throughput_bps(f.now_s)
        if not estimate_bps:
            return False
        best = max(self._replacements(SAFETY * estimate_bps), key=lambda r: r[0], default=None)
        if best is None:
            return False
        _, slot, option = best
        reason = f"{option.quality:.1f} dB in place of {slot.psnr:.1f}"
        batch, rtt_s = self._replacing(slot, option.index), f.connection.rtt_s
        request = Request(BatchKind.REPLACEMENT, slot.position, option.index, batch, f.now_s, rtt_s)
        arrival = yield from f.receive(request)
        self.use_keys(request)
        yield Arrived(arrival, Decision(option.index, True, reason, option.size_bytes), 0.0, estimate_bps)
        if arrival.complete and f.now_s + f.settings.decode_frame_s <= slot.start_s:
            yield Replaced(slot.position, slot.rung, option.index)
            slot.rung = option.index
        return True

    def _replacements(self, rate_bps: float) -> Iterator[tuple[float, Slot, Option]]:
        """(dB seconds a byte, segment, rung) of everything that would be better and is expected in time."""
        f = self.fetcher
        free_s = f.now_s + f.connection.rtt_s
        for slot, offer in self.playout.pending():
            if not f.now_s < slot.start_s < math.inf:
                continue
            here = offer.rungs[slot.rung]
            for option in f.keys.options(f.loop(slot.position), offer):
                gain = option.quality - here.psnr
                if gain < REPLACE_GAIN_DB:
                    continue
                size = option.size_bytes  # the state is decoded where only the keys would be better
                size -= here.state_bytes if offer.rungs[option.index].level == here.level else 0
                if free_s + 8 * size / rate_bps + f.settings.decode_frame_s > slot.start_s:
                    continue
                if not f.unusable or f.usable(self._replacing(slot, option.index)):
                    yield gain * slot.seconds / max(1, size), slot, option

    def _replacing(self, slot: Slot, rung: int) -> Batch:
        """Return what it takes to show another rung of a buffered segment: with the same level, only its keys."""
        offer, batch = self.fetcher.offer(slot.position), self.fetcher.missing(slot.position, rung)
        return Batch(batch.keys) if offer.rungs[rung].level == offer.rungs[slot.rung].level else batch
