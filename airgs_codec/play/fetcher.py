"""What a player asks for and gets: tables, decoded keyframes, and the throughput measured on the way."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from airgs_codec.errors import FormatError
from airgs_codec.package.layout import POSTER_NAME, FileKind, file_kind, group_path, locate
from airgs_codec.package.manifest import Manifest
from airgs_codec.package.tables import PAGE
from airgs_codec.play.downloader import Arrival, Arrived, BatchKind, Downloader, GiveUp, Partial, Request
from airgs_codec.play.ladder import Decision, Option
from airgs_codec.play.offers import NONE, Batch, Keyframe, Keyframes, Offers, SegmentOffer
from airgs_codec.play.playout import SessionSettings
from airgs_codec.play.policies import Coming, Download, Policy

REMEMBERED = 24  # downloads that policies know
NOTHING = Download(0, 1.0)
SHORTEST_S = 1e-9  # a download that rounds to no time still has a rate


@dataclass(slots=True, eq=False)
class TableStore:
    """The tables that have come: pages of the index and tables of groups are fetched once, whatever is played again."""

    offers: Offers
    first: int = 0  # the segment before which nothing is played any more
    _paths: set[str] = field(default_factory=set)
    _complete: dict[int, Manifest] = field(default_factory=dict)  # segments of which nothing is missing, and as of when

    def add(self, arrival: Arrival) -> None:
        self._paths.update(path for path in arrival.usable if file_kind(path) in (FileKind.MANIFESTS, FileKind.POSTER))

    def has(self, position: int) -> bool:
        return self._next(self.offers.place(position)[1]) is None

    def missing(self, positions: range) -> tuple[str, ...]:
        """Return the next missing page or table of each position, and the poster, in case nobody has seen it."""
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
        self._complete = {segment: m for segment, m in self._complete.items() if segment >= before.segment}
        self._paths = {path for path in self._paths if not _is_past(path, before)}

    def _next(self, segment: int) -> str | None:
        """Return the first missing table on the way to a segment and to its base group; None if all are there."""
        manifest = self.offers.manifest
        if self._complete.get(segment) is manifest:
            return None
        path = next((path for path in self._way(segment) if path not in self._paths), None)
        if path is None:
            self._complete[segment] = manifest
        return path

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
class Fetcher:
    offers: Offers
    downloader: Downloader
    policy: Policy
    settings: SessionSettings
    tables: TableStore = field(init=False)
    now_s: float = 0.0  # when the last batch was over, or when there was room for the next
    downloads: list[tuple[float, Download]] = field(default_factory=list)  # with their arrivals
    first: Download = NOTHING  # the fastest of tables and poster, the wait for its first byte included
    unusable: set[str] = field(default_factory=set)  # files found missing or corrupt
    given_up: tuple[int, int] = (-1, 0)  # position and size: nothing as large is asked for there again
    _keyframes: dict[int, set[Keyframe]] = field(
        default_factory=dict
    )  # decoded, by loop: what is played again is fetched again

    def __post_init__(self) -> None:
        self.tables = TableStore(self.offers)

    def forget(self, position: int, before: SegmentOffer) -> None:
        """Drop what is known of groups before a position, whose offer is given."""
        self.tables.forget(before)
        there, loop = (before.base, before.group), self.loop(position)
        self._keyframes[loop] = {key for key in self.decoded(loop) if key[0] in there or key[0] > before.group}

    def loop(self, position: int) -> int:
        return self.offers.place(position)[0]

    def offer(self, position: int) -> SegmentOffer:
        return self.offers.offer(self.offers.place(position)[1], self.settings.budget)

    def decoded(self, loop: int) -> Keyframes:
        return self._keyframes.get(loop, NONE)

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
        """Return the rungs at a position that can be fetched and are smaller than a download abandoned there."""
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
