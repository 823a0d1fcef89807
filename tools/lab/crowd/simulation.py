"""A crowd of viewers behind one edge: real players over LTE traces, a shared link, a cache and an origin.

Time goes on in ticks, for which the fair level of the shared link holds; within a tick, everything happens at its own
time: bits pass at the rates of the traces, players choose when a batch is over, the origin's transfers begin and end.
So a viewer alone behind a link that is wide enough has the very session of `airgs_codec.simulate`.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from airgs_codec.errors import ConfigError
from airgs_codec.play.policies.named import DEFAULT_POLICY
from airgs_codec.play.settings import SessionSettings
from airgs_codec.play.trace import DEFAULT_RTT_S, Trace
from airgs_codec.progress import Progress, silent
from tools.lab.crowd.edge import Edge, EqualShares, LruCache
from tools.lab.crowd.links import Flows, SharedLink, Traces
from tools.lab.crowd.policies import crowd_policy
from tools.lab.crowd.programme import Programme
from tools.lab.crowd.viewer import Batch, Seen, Viewer

JOIN, BEGIN, EMPTY, LOOK, ASK_ORIGIN = range(5)  # kinds of events; of the same moment, in this order


@dataclass(frozen=True, slots=True)
class CrowdSettings:
    """Who watches, and over what. Rates are bit/s; infinite: no limit. Raises ConfigError."""

    viewers: int = 10_000
    policies: tuple[str, ...] = (DEFAULT_POLICY,)  # in equal shares
    join_s: float = 20.0  # viewers come one by one in this time, as a Poisson process has it
    watch_s: float = 20.0  # media time that each watches
    late: float = 0.1  # share that begins at the beginning of the programme, not at its present place
    bottleneck_bps: float = math.inf  # from the edge to all viewers together
    origin_bps: float = 1e9
    origin_rtt_s: float = 0.04
    cache_bytes: float = 64e6
    rtt_s: float = DEFAULT_RTT_S  # from a viewer to the edge
    tick_s: float = 0.01
    seed: int = 1
    session: SessionSettings = field(default_factory=SessionSettings)

    def __post_init__(self) -> None:
        if self.viewers < 1 or not self.policies:
            raise ConfigError("expected at least one viewer and one policy")
        for name in ("watch_s", "bottleneck_bps", "origin_bps", "tick_s"):
            if not getattr(self, name) > 0:
                raise ConfigError(f"{name}: expected more than 0, got {getattr(self, name):g}")
        for name in ("join_s", "origin_rtt_s", "cache_bytes", "rtt_s"):
            if not getattr(self, name) >= 0:
                raise ConfigError(f"{name}: expected 0 or more, got {getattr(self, name):g}")
        if not 0 <= self.late <= 1:
            raise ConfigError(f"late: expected a share of 0 to 1, got {self.late:g}")


@dataclass(frozen=True, slots=True, eq=False)
class Guest:
    """Who comes when, and with what."""

    join_s: float
    late: bool
    trace: int
    offset_s: float
    policy: str


def draw_guests(settings: CrowdSettings, traces: Sequence[Trace]) -> list[Guest]:
    """All viewers by the time that they come, drawn from the seed.

    The times of a Poisson process of which the number of arrivals is known are those of as many uniform draws.
    """
    random, count = np.random.default_rng(settings.seed), settings.viewers
    joins = np.sort(random.uniform(0, settings.join_s, count))
    late = random.random(count) < settings.late
    which = random.integers(0, len(traces), count)
    offsets = random.random(count) * [traces[k].duration_s for k in which]
    names = [settings.policies[n % len(settings.policies)] for n in random.permutation(count)]
    columns = joins.tolist(), late.tolist(), which.tolist(), offsets.tolist(), names
    return [Guest(*row) for row in zip(*columns, strict=True)]


@dataclass(slots=True, eq=False)
class Second:
    """A second of the crowd."""

    viewers: int = 0  # whose session goes on at its end
    egress_bytes: float = 0.0  # of the shared link
    origin_bytes: int = 0
    requests: int = 0


@dataclass(frozen=True, eq=False)
class Outcome:
    """What came of a crowd."""

    settings: CrowdSettings
    seen: tuple[Seen, ...]  # by viewer
    edge: Edge
    seconds: tuple[Second, ...]
    passed_bytes: float  # of the shared link


def run_crowd(
    programme: Programme, traces: Sequence[Trace], settings: CrowdSettings, progress: Progress = silent
) -> Outcome:
    """Simulate until the last viewer has seen the last picture. Raises ConfigError for a policy that cannot be."""
    crowd = _Crowd(programme, traces, settings)
    while crowd.seen.count(None):
        crowd.tick()
        if crowd.ticks % 1000 == 0:
            progress("viewers", settings.viewers - crowd.seen.count(None), settings.viewers)
    seen = tuple(s for s in crowd.seen if s is not None)
    return Outcome(settings, seen, crowd.edge, tuple(crowd.seconds), crowd.link.passed_bits / 8)


class _Crowd:
    """The simulation under way. Events are (time, kind, viewer, number of the viewer's batch, path)."""

    def __init__(self, programme: Programme, traces: Sequence[Trace], settings: CrowdSettings) -> None:
        self.programme, self.traces, self.settings = programme, traces, settings
        self.policies = {name: crowd_policy(name, programme.whole) for name in settings.policies}
        self.guests = draw_guests(settings, traces)
        flows = Flows.idle(
            np.array([g.trace for g in self.guests]), np.array([g.offset_s - g.join_s for g in self.guests])
        )
        self.flows = flows
        self.link = SharedLink(flows, Traces.of(traces), settings.bottleneck_bps, settings.tick_s)
        self.edge = Edge(LruCache(settings.cache_bytes))
        self.origin = EqualShares(settings.origin_bps)
        self.viewers: list[Viewer | None] = [None] * len(self.guests)
        self.seen: list[Seen | None] = [None] * len(self.guests)
        self.batch_numbers = [0] * len(self.guests)
        self.watching = 0
        self.seconds: list[Second] = []
        self.ticks = 0
        self._events = [(g.join_s, JOIN, i, 0, "") for i, g in enumerate(self.guests)]

    def tick(self) -> None:
        """Let a tick pass."""
        at_s = self.ticks * self.settings.tick_s
        for viewer in self.link.tick(at_s).tolist():
            self._push(float(self.flows.at_s[viewer]), EMPTY, viewer)
        until_s = self.link.until_s
        while True:
            origin_s = self.origin.next_s()
            event_s = self._events[0][0] if self._events else math.inf
            if min(origin_s, event_s) >= until_s:
                break
            if origin_s <= event_s:
                self._origin_sent(origin_s, self.origin.finish())
            else:
                self._happen(*heapq.heappop(self._events))
        self.ticks += 1
        self._note(at_s)

    def _note(self, at_s: float) -> None:
        """Keep the books of the second that a tick belongs to."""
        while len(self.seconds) <= int(at_s + 1e-9):
            self.seconds.append(Second())
        now, tally = self.seconds[-1], self.edge.tally
        now.viewers = self.watching
        now.egress_bytes = self.link.passed_bits / 8 - sum(s.egress_bytes for s in self.seconds[:-1])
        now.origin_bytes = tally.origin_bytes - sum(s.origin_bytes for s in self.seconds[:-1])
        now.requests = tally.requests - sum(s.requests for s in self.seconds[:-1])

    def _push(self, at_s: float, kind: int, viewer: int, path: str = "") -> None:
        heapq.heappush(self._events, (at_s, kind, viewer, self.batch_numbers[viewer], path))

    def _happen(self, at_s: float, kind: int, i: int, number: int, path: str) -> None:
        if kind == ASK_ORIGIN:
            self.origin.start(path, number, at_s)
        elif number != self.batch_numbers[i]:
            return  # of a batch that is over
        elif kind == JOIN:
            self._join(i)
        elif kind == BEGIN:
            self._begin(i, at_s)
        elif kind == EMPTY:
            self._empty(i, at_s)
        else:
            self._look(i, at_s)

    def _join(self, i: int) -> None:
        guest, s = self.guests[i], self.settings
        visit = self.programme.visit(0.0 if guest.late else guest.join_s, s.watch_s)
        viewer = Viewer(visit, self.policies[guest.policy], s.session, s.rtt_s)
        self.viewers[i] = viewer
        self.watching += 1
        viewer.next_batch()
        self._asked(i)

    def _asked(self, i: int) -> None:
        """The viewer has a new batch, or has none and is through."""
        guest, viewer = self.guests[i], self._viewer(i)
        self.batch_numbers[i] += 1
        if viewer.batch is None:
            self.seen[i] = viewer.seen(i, guest.policy, self.traces[guest.trace].name, guest.late, guest.join_s)
            self.viewers[i] = None
            self.watching -= 1
        else:
            self._push(guest.join_s + viewer.batch.first_s, BEGIN, i)

    def _begin(self, i: int, at_s: float) -> None:
        """The request is at the edge."""
        batch, s = self._batch(i), self.settings
        self.flows.left_bits[i], self.flows.at_s[i], self.flows.stop_s[i] = 0.0, at_s, math.inf
        if batch.give_up is not None:
            self._look_later(i)
        for path, size in batch.sizes.items():
            fetched = self.edge.ask(path, size, i)
            if fetched == 0:
                batch.add(path, 0.0)
                continue
            batch.away += 1
            if fetched is not None:
                heapq.heappush(self._events, (at_s + s.origin_rtt_s, ASK_ORIGIN, i, fetched, path))
        self.flows.left_bits[i] = 8 * batch.came_bytes
        self._go_on(i)

    def _look_later(self, i: int) -> None:
        look_s = self.guests[i].join_s + self._batch(i).look_s
        self.flows.stop_s[i] = look_s
        self._push(look_s, LOOK, i)

    def _origin_sent(self, at_s: float, path: str) -> None:
        """A file is at the edge: whoever waits for it goes on."""
        for i in self.edge.arrived(path):
            batch = self.viewers[i] and self._viewer(i).batch
            if not batch or path not in batch.sizes or path in batch.rest or at_s < self._begins_s(i):
                continue  # the viewer has given up
            batch.away -= 1
            batch.add(path, self._passed_bytes(i))
            if self.flows.left_bits[i] <= 0:
                self.flows.at_s[i] = max(at_s, self.flows.at_s[i])
            self.flows.left_bits[i] += 8 * batch.sizes[path]
            self._go_on(i)

    def _begins_s(self, i: int) -> float:
        return self.guests[i].join_s + self._batch(i).first_s

    def _passed_bytes(self, i: int) -> float:
        return self._batch(i).came_bytes - float(self.flows.left_bits[i]) / 8

    def _go_on(self, i: int) -> None:
        if self.flows.left_bits[i] > 0 and self.link.go_on(i):
            self._push(float(self.flows.at_s[i]), EMPTY, i)

    def _empty(self, i: int, at_s: float) -> None:
        """All that was at the edge has passed."""
        batch = self._batch(i)
        if not batch.away and self.flows.left_bits[i] <= 0:
            self._over(i, at_s, abandoned=False)

    def _look(self, i: int, at_s: float) -> None:
        """The player looks at a download that is under way."""
        if self._batch(i).is_given_up(self._passed_bytes(i)):
            self._over(i, at_s, abandoned=True)
        else:
            self._look_later(i)
            self._go_on(i)

    def _over(self, i: int, at_s: float, abandoned: bool) -> None:
        viewer, passed = self._viewer(i), self._passed_bytes(i)
        self.flows.left_bits[i] = 0.0
        viewer.next_batch(self._batch(i).end(at_s - self.guests[i].join_s, passed, abandoned))
        self._asked(i)

    def _viewer(self, i: int) -> Viewer:
        viewer = self.viewers[i]
        assert viewer is not None
        return viewer

    def _batch(self, i: int) -> Batch:
        batch = self._viewer(i).batch
        assert batch is not None
        return batch
