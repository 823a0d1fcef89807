"""A player that fetches the tiles that its viewer is expected to see (`tile_choice`), one after another.

A segment's tiles are fetched each by itself, in the rung that its policy chose for all of them together, so that what
the segments before it turn out to lack need not wait: that is fetched first, in the rung of its segment, or, where that
would come after the segment is over, in the smallest one. Where a download is given up, the tiles that are still to
come may have another rung than those that came. Nothing that is buffered is replaced: the buffer is short.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from airgs_codec.play.downloader import Fetching, GiveUp, Partial, Steps
from airgs_codec.play.events import Arrived, BatchKind, Request, TileReady
from airgs_codec.play.ladder import Decision, Option
from airgs_codec.play.player import Player
from airgs_codec.play.playout import Slot
from airgs_codec.play.policies.state import PlayerState, budget_bytes, estimate_throughput
from airgs_codec.play.sight import View
from airgs_codec.play.tile_choice import TileChoice
from airgs_codec.play.tile_figures import tile_of

LOOK_S = 0.05  # a player that waits looks so often what is lacking


@dataclass(slots=True, eq=False)
class ViewPlayer(Player):
    """State of one session in which tiles are fetched by view."""

    view: View = field(kw_only=True)
    choice: TileChoice = field(init=False)
    idle_s: float = 0.0  # when nothing was to be fetched the last time
    no_use: set[tuple[int, int]] = field(default_factory=set)  # position and tile of repairs that came to nothing

    def __post_init__(self) -> None:
        Player.__post_init__(self)
        self.playout.room_for_two = True
        self.choice = TileChoice(self.catalogue, self.playout, self.view)

    def _wait(self, until_s: float) -> Steps:
        """Look what is lacking until the next request, or until the last picture."""
        end_s = min(until_s, self.playout.scheduled_end_s)
        while self.now_s < end_s:
            if not (yield from self._repair()):
                self.now_s = self.idle_s = min(end_s, self.now_s + LOOK_S)

    def _fetch_next(self, position: int, latency_s: float) -> Fetching[bool]:
        """Choose tiles of the next segment and a rung for them, and fetch one after another; always True."""
        if not self.tables.has(position):
            yield from self._lose(position)
            return True
        wanted = self.choice.early(position, self._sent_s(latency_s))
        if wanted:
            came = yield from self._fetch_tiles(position, wanted, latency_s)
            rung = self._worst(position, came) if came else None
        else:  # no tile has rows: an empty scene is shown, for which nothing is fetched
            came, state = {}, self._state(position, latency_s, wanted)
            rung = self.policy.choose(state).index if state.options else None
        if rung is None:
            yield from self._lose(position)
            return True
        self.playout.enqueue(position, rung, self.now_s, came)
        for tile, of_tile in came.items():
            yield TileReady(position, tile, of_tile, self.now_s + self.settings.decode_frame_s)
        return True

    def _fetch_tiles(self, position: int, wanted: list[int], latency_s: float) -> Fetching[dict[int, int]]:
        """Fetch tiles of the next segment one after another: those that came, each with its rung.

        A tile that cannot be had in any rung is left out. Where no rung is left that all of them can be had in, the
        next tile has one for itself.
        """
        earliest_s = self.playout.earliest_request_s(position)
        came: dict[int, int] = {}
        decision: Decision | None = None
        while left := [tile for tile in wanted if tile not in came and self._can_be_had(position, tile)]:
            if (yield from self._repair()):
                latency_s = self._latency_s(earliest_s)
                continue
            state = self._state(position, latency_s, left)
            if not state.options:
                left = left[:1]
                state = self._state(position, latency_s, left)
            if not state.options:
                wanted = [tile for tile in wanted if tile not in left]
                continue
            if decision is None or decision.index not in {option.index for option in state.options}:
                decision = self.policy.choose(state)
            if (yield from self._fetch_tile(state, decision, left, latency_s)):
                came[left[0]] = decision.index
            else:
                decision = None
            latency_s = self._latency_s(earliest_s)
        return came

    def _can_be_had(self, position: int, tile: int) -> bool:
        faulty = any(tile_of(path) == tile for path in self.unusable)
        return not faulty or bool(self._usable_options(position, tile))

    def _usable_options(self, position: int, tile: int) -> list[Option]:
        """The rungs in which a tile can be had."""
        return [
            option
            for option in self.keys.options(position, [tile])
            if self._usable(self.keys.missing(position, option.index, [tile]))
        ]

    def _use_keys(self, request: Request) -> None:
        """What is buffered is shown as it was fetched."""

    def _worst(self, position: int, rungs: dict[int, int]) -> int:
        """The rung of a segment whose tiles have several."""
        quality = self.catalogue.quality[self.catalogue.index(position)]
        return min(rungs.values(), key=lambda rung: (quality[rung], -rung))

    def _fetch_tile(self, state: PlayerState, decision: Decision, left: list[int], latency_s: float) -> Fetching[bool]:
        """Fetch the first of the tiles that are left; False: it was abandoned or broken."""
        position, rung = state.position, decision.index
        ahead = self._wanted_tables(position + 1) if position else ()  # nothing delays the first picture
        batch = replace(self.keys.missing(position, rung, left[:1]), tables=ahead)
        if not batch.files:
            return True
        kind = BatchKind.GROUP if batch.keys else BatchKind.STATE
        request = Request(kind, position, rung, batch, self._sent_s(latency_s), latency_s)
        rest = {option.index: option.size_bytes for option in self.keys.options(position, left)}[rung]
        arrival = yield from self._receive(request, self._give_up(state, replace(decision, size_bytes=rest)))
        yield Arrived(arrival, decision, budget_bytes(state), estimate_throughput(state.history))
        if arrival.abandoned:
            self.given_up = position, rest
        return arrival.complete

    def _repair(self) -> Fetching[bool]:
        """Fetch the tile that is lacking most; False: none is that could be had in time."""
        latency_s = self._latency_s(self.idle_s)
        for slot, tile in self.choice.lacking(self._sent_s(latency_s)):
            option = None if (slot.position, tile) in self.no_use else self._repairing(slot, tile, latency_s)
            if option is not None:
                yield from self._fetch_lacking(slot, tile, option, latency_s)
                return True
        return False

    def _repairing(self, slot: Slot, tile: int, latency_s: float) -> Option | None:
        """A tile in the rung of its segment, or else in the smallest one; None where both would come too late."""
        rate_bps = estimate_throughput(self._history(self._sent_s(latency_s)))
        at_s = self.now_s + latency_s + self.settings.decode_frame_s
        options = self._usable_options(slot.position, tile)
        wanted = [option for option in options if option.index == slot.rung]
        wanted += sorted(options, key=lambda option: option.size_bytes)[:1]
        end_s = self.playout.end_s(slot)
        rate_bps = rate_bps or math.inf
        return next((option for option in wanted if at_s + 8 * option.size_bytes / rate_bps < end_s), None)

    def _fetch_lacking(self, slot: Slot, tile: int, option: Option, latency_s: float) -> Steps:
        batch, end_s = self.keys.missing(slot.position, option.index, [tile]), self.playout.end_s(slot)
        if batch.files:
            sent_s = self._sent_s(latency_s)
            request = Request(BatchKind.REPAIR, slot.position, option.index, batch, sent_s, latency_s)
            arrival = yield from self._receive(request, _after(end_s))
            words = f"tile {tile + 1} is lacking"
            decision = Decision(option.index, True, words, option.size_bytes)
            yield Arrived(arrival, decision, 0.0, estimate_throughput(self._history(sent_s)))
            if not arrival.complete:
                self.no_use.add((slot.position, tile))
                return
        slot.tiles[tile] = option.index
        yield TileReady(slot.position, tile, option.index, self.now_s + self.settings.decode_frame_s)


def _after(end_s: float) -> GiveUp:
    """Give up what, at the rate so far, would come after a moment."""

    def too_late(partial: Partial) -> bool:
        rate = max(partial.bytes, 1.0) / partial.elapsed_s
        return partial.at_s + (partial.expected_bytes - partial.bytes) / rate > end_s

    return too_late
