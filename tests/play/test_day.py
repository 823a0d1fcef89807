"""A day of publishing a group every minute, and a viewer who stays for it: nothing grows but the package."""

from __future__ import annotations

import gzip
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime

from airgs_codec.play.downloader import answer
from airgs_codec.play.fetcher import Fetcher
from airgs_codec.play.offers import HEADER_BYTES
from airgs_codec.play.player import Player
from airgs_codec.play.playout import Playout
from tests.faces import (
    JSON_NAME,
    MPD_NAME,
    POSTER_NAME,
    Arrival,
    Arrived,
    BatchKind,
    Groups,
    GrowingPackage,
    LiveClock,
    Manifest,
    Memory,
    RemoteTables,
    Request,
    SessionSettings,
    make_policy,
    open_package,
    write_tables,
)
from tests.support.paths import VALID

NOW = datetime(2026, 1, 1, tzinfo=UTC)
DAY_S = 86_400
REMEMBERED_GROUPS = 100
TOLD_BYTES = 10_000  # airgs.json and manifest.mpd each


class Publisher:
    """A package that gains one group again and again, as fast as it plays; its media are only told of."""

    def __init__(self, m: Manifest, seconds: float) -> None:
        self._group, self._seconds = m.groups[0], seconds
        self.frames = self._group.stop
        m = replace(m, live=True, frames=self.frames, groups=Groups.of([self._group]))
        self.files = Memory("day")
        write_tables(self.files, m, LiveClock(NOW, NOW))
        self.package = GrowingPackage(self.files, m, NOW)

    def publish_until(self, at_s: float) -> None:
        m = self.package.manifest
        while (start := self.package.manifest.frames) + self.frames <= min(at_s, self._seconds) * m.fps:
            segments = [replace(s, start=s.start + start, stop=s.stop + start) for s in self._group.segments]
            self.package.add(replace(self._group, start=start, stop=start + self.frames, segments=segments))
        if at_s >= self._seconds and m.live:
            self.package.close()


@dataclass
class Link:
    """Brings every batch in a tenth of a second."""

    publisher: Publisher
    tables: RemoteTables = field(default_factory=RemoteTables)
    table_bytes: int = 0  # as an HTTP server sends them, headers and answers that nothing has changed included
    root: bytes = b""
    rtt_s: float = 0.1
    pipelines: bool = False

    def bring(self, path: str) -> None:
        data = self.publisher.files.read(path)
        unchanged, self.root = path == JSON_NAME and data == self.root, data if path == JSON_NAME else self.root
        self.table_bytes += HEADER_BYTES + (0 if unchanged else len(gzip.compress(data)))
        self.tables.accept(path, data)

    def fetch(self, request: Request, give_up: object = None) -> Arrival:
        self.publisher.publish_until(request.sent_s)
        for path in request.batch.tables:
            if path != POSTER_NAME:
                self.bring(path)
        at_s = request.sent_s + self.rtt_s
        return Arrival(request, at_s, at_s, 1000, request.batch.files, {}, False)


def memory_of(link, player):
    """How many of each thing publisher, tables and player know."""
    tables, keys = player.fetcher.tables, player.fetcher.keys
    return {
        "tables of the publisher": len(link.publisher.package.manifest.groups._kept),
        "names": len(tables._paths),
        "segments": len(tables._complete),
        "keys": len(keys.decoded(0)),
        "options": len(keys._options),
        "downloads": len(player.fetcher.downloads),
        "timeline": len(player.playout.timeline),
    }


def stay(link, rung):
    """A player of a rung on a link, whose events are yet to be asked for."""
    link.bring(JSON_NAME)
    offers, rules = link.tables.offers, SessionSettings(decode_frame_s=0.0)
    return Player(Fetcher(offers, link, make_policy(rung, offers), rules), Playout(rules))


def test_a_day_of_live_publishing_and_a_viewer_who_stays_end_flat():
    minutes = replace(open_package(VALID / "paged").manifest, frame_rate=[1, 60], timescale=1)
    publisher = Publisher(minutes, DAY_S)
    link = Link(publisher)
    player = stay(link, "fixed:0")
    shown, asked, seen = 0, 0, []
    for event in answer(player.play(), link):
        if type(event).__name__ == "Shown":
            shown += 1
            assert event.rung == 0
        asked += type(event).__name__ == "Arrived" and event.arrival.request.kind is BatchKind.TABLES
        if shown and shown % 250 == 0:
            seen.append(memory_of(link, player))
    assert shown == DAY_S // 60 and not publisher.package.manifest.live
    assert asked <= 3 * shown  # airgs.json and what it leads to
    for name in seen[0]:
        assert max(s[name] for s in seen) <= 2 * REMEMBERED_GROUPS, name
        assert max(s[name] for s in seen[-3:]) <= 1.2 * max(s[name] for s in seen[:3]) + 4, name
    assert len(publisher.files.read(JSON_NAME)) <= TOLD_BYTES and len(publisher.files.read(MPD_NAME)) <= TOLD_BYTES


def test_tables_of_a_growing_package_are_a_twentieth_of_its_media(demo_package):
    """A third of a minute of the demo scene, whose groups have five frames."""
    m = open_package(demo_package).manifest
    publisher = Publisher(m, 20.0)
    link, media = Link(publisher), 0
    for event in answer(stay(link, "fixed:0").play(), link):
        if isinstance(event, Arrived):
            batch = event.arrival.request.batch
            media += sum(link.tables.offers.file_bytes(path) for path in (*batch.keys, *batch.state))
    assert media > 0 and link.table_bytes <= 0.05 * media
