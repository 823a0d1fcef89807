"""A player over a growing package: it joins late, goes on as groups appear, and ends with the package.

Tables that come over a connection must be those of the same package with more groups, and however long a viewer stays,
nothing grows but the package.
"""

import gzip
import shutil
from dataclasses import replace
from datetime import UTC, datetime
from functools import cache
from itertools import pairwise
from unittest.mock import patch

import pytest

from airgs_codec.play import player
from tests import faces
from tests.faces import JSON_NAME, FormatError, HttpSettings, RemoteTables, SessionSettings, group_path, open_package
from tests.support.faulty import Weather, faultily_serving
from tests.support.growing import Growing
from tests.support.paths import VALID
from tests.support.refusals import cases
from tests.support.regions import region
from tests.support.servers import serving
from tests.support.session_packages import long_index

RULES = SessionSettings(startup_s=0.0, resume_s=0.0, decode_frame_s=0.0)
FAST = HttpSettings(as_fast=True, backoff_s=0.001)


def play_growing(growing, weather=None, rules=RULES, http=FAST, server=None):
    with (
        patch.object(player, "POLL_S", 0.0),
        server or faultily_serving(growing.folder, weather or Weather(0.0)) as port,
        faces.HttpDownloader(f"http://127.0.0.1:{port}/{'p' if server else ''}", http, growing.received) as downloader,
    ):
        return faces.play(downloader.open(), downloader, "fixed:0", rules)


@pytest.mark.parametrize(("counts", "shown"), [
    ((2, 3, 3, 5, 0), [1, 2, 3, 4]),
    ((62, 63, 64, 65, 0), [61, 62, 63, 64]),  # the first page comes into being
    ((62, 65, 0), [61, 62, 63, 64]), ((65, 0), [64]),
    ((64, 65, 0), [63, 64]),  # the page alone says where the newest group is
])  # fmt: skip
def test_a_session_begins_with_the_newest_group_and_ends_with_the_package(tmp_path, counts, shown):
    log = play_growing(Growing(tmp_path / "p", *counts))
    assert [s.segment for s in log.shown] == shown and all(s.rung == 0 for s in log.shown)
    assert not log.lost and not log.offers.live
    assert all(b.start_s >= a.start_s + a.frames / log.offers.fps - 1e-9 for a, b in pairwise(log.shown))
    assert log.metrics.frames == len(shown)


def test_who_joins_late_fetches_the_base_of_the_newest_group_once(tmp_path):
    """Groups 2 and 3 keep rows of group 1, which is over."""
    log = play_growing(Growing(tmp_path / "p", 2, 3, 0, whole=VALID / "inter"))
    m = open_package(VALID / "inter").manifest
    assert [s.segment for s in log.shown] == [1, 2] and all(s.rung == 0 for s in log.shown)
    assert [g.base for g in m.groups] == [None, 1, 1]
    keyframes = {path for g in range(3) for t in range(m.tiers) for path in m.keyframe_files(g, t, 0)}
    assert log.bytes_by_kind["keyframe"] + log.bytes_by_kind["sidecars"] == m.bytes_of(sorted(keyframes))


def test_groups_are_looked_for_a_groups_length_after_the_last_time(tmp_path):
    log = play_growing(Growing(tmp_path / "p", 2, 2, 2, 3, 0))
    polls = [f for f in log.fetches if f.position == 1 and f.kind == "tables"]
    roots = [0.0, *(f.request_s for f in polls[:3])]  # then there is a table to fetch
    assert all(b - a >= 1 / 30 - 1e-6 for a, b in pairwise(roots))


def test_an_airgs_json_that_has_not_changed_is_not_sent_again(tmp_path):
    growing = Growing(tmp_path / "p", 2, 2, 2, 3, 0)
    log = play_growing(growing, http=HttpSettings(backoff_s=0.001), server=serving(growing.folder))
    sizes = [f.bytes for f in log.fetches if f.kind == "tables" and f.files == 1]
    whole = (growing.folder / JSON_NAME).stat().st_size
    assert [s.segment for s in log.shown] == [1, 2]
    assert max(sizes[1:]) < whole and min(sizes) < 700  # packed, or a head alone


def test_what_waits_is_shown_when_nothing_follows(tmp_path):
    """There is less media than playing begins with."""
    log = play_growing(Growing(tmp_path / "p", 2, 3, 0), rules=replace(RULES, startup_s=60.0, buffer_s=100.0))
    assert [s.segment for s in log.shown] == [1, 2] and log.shown[0].start_s >= log.fetches[-1].arrival_s


@pytest.mark.parametrize("another", [False, True])
def test_a_package_that_stops_growing_or_gives_way_to_another_ends_the_session(tmp_path, monkeypatch, another):
    monkeypatch.setattr(player, "GONE_S", 0.1)
    growing = Growing(tmp_path / "p", 2)
    if another:
        growing.received = lambda path, data: shutil.copy(VALID / "live" / JSON_NAME, growing.folder / JSON_NAME)
    log = play_growing(growing)
    assert [s.segment for s in log.shown] == [1] and "no group has followed" in log.lost[-1]
    assert any("another" in line for line in log.lost) is another


def test_faults_are_survived_while_it_grows(tmp_path):
    growing = Growing(tmp_path / "p", *range(50, 66), 0)
    log = play_growing(growing, Weather(0.2, {"drop": 1.0, "truncation": 1.0, "wrong bytes": 1.0}))
    assert [s.segment for s in log.shown] == list(range(49, 65)) and log.retried


def test_without_its_pages_a_growing_package_cannot_go_on(tmp_path):
    growing = Growing(tmp_path / "p", 62, 64, 65, 0)
    publish, page = growing.publish, growing.folder / "index/1/1.json"
    growing.publish = lambda: (publish(), page.unlink(missing_ok=True))
    with pytest.raises(faces.TransportError, match=r"index/1/1\.json"):
        play_growing(growing)


def test_a_simulated_session_plays_what_there_is(tmp_path):
    package = open_package(Growing(tmp_path / "p", 3).folder)
    log = faces.simulate(package, faces.Trace.open("const:9"), "fixed:0", replace(RULES, loops=1))
    assert [s.segment for s in log.shown] == [0, 1, 2]


@cache
def root(count, spoilt=None, **fields):
    """An airgs.json of so many groups of a frame each, while more are to come, with another first entry of a level."""
    index = list(long_index(count)[0])
    if spoilt is not None:
        index[spoilt] = replace(index[spoilt], sha256="_" + index[spoilt].sha256[1:])
    known = replace(faces.root_of(open_package(VALID / "paged").manifest), live=True, frames=count, index=index)
    return faces.pack_json(replace(known, **fields))


def grown(*roots):
    tables = RemoteTables()
    for data in roots:
        tables.accept(JSON_NAME, data)
    return tables


def test_pages_of_every_level_lead_to_groups_as_a_package_grows():
    tables, (_, pages) = grown(root(4095)), long_index(4097)
    places = tables.offers.manifest.groups.places
    tables.accept("index/1/2.json", faces.pack_json(pages["index/1/2.json"]))
    assert places.at_frame(64) == 64
    tables.accept(JSON_NAME, root(4097))
    places = tables.offers.manifest.groups.places
    assert places.at_frame(4096) == 4096
    with pytest.raises(FormatError, match="has not been fetched"):
        places.at_frame(64)
    with pytest.raises(FormatError, match="has not been fetched"):
        tables.accept("index/1/64.json", faces.pack_json(pages["index/1/64.json"]))
    for path in ("index/2/1.json", "index/1/64.json"):
        tables.accept(path, faces.pack_json(pages[path]))
    assert [places.at_frame(frame) for frame in (64, 4095)] == [64, 4095]  # the page of before is as good as ever


@pytest.mark.parametrize("order", [(1, 2, 3), (3, 2, 1), (2, 1, 3)])
def test_tables_that_keep_rows_of_another_may_come_before_it_but_no_chain_of_them(order):
    folder, chain = VALID / "inter", cases()["bad_value-base-chain"].package()
    tables, chained = grown((folder / JSON_NAME).read_bytes()), grown(chain[JSON_NAME])
    for number in order:
        tables.accept(group_path(number), (folder / group_path(number)).read_bytes())
    assert [group.base for group in tables.offers.manifest.groups] == [None, 1, 1]
    first, second = (group_path(number) for number in order if number > 1)
    chained.accept(first, chain[first])
    for _ in range(2):
        with pytest.raises(FormatError) as refused:
            chained.accept(second, chain[second])
        assert refused.value.reason == "bad_value"


def test_a_page_that_is_not_what_the_level_above_says_is_refused():
    tables, (_, pages) = grown(root(4097)), long_index(4097)
    page = pages["index/2/1.json"]
    for data in (faces.pack_json(page)[:-1], faces.pack_json(replace(page, sha256="_" + page.sha256[1:]))):
        with pytest.raises(FormatError) as refused:
            tables.accept("index/2/1.json", data)
        assert refused.value.reason in ("size_mismatch", "hash_mismatch")
    with pytest.raises(FormatError, match="no table has such a file"):
        tables.accept("index/2/2.json", faces.pack_json(page))


@pytest.mark.parametrize(("before", "count", "fields"), [
    *(({}, 4161, {}), ({}, 70, {})),  # with fewer groups
    *(({}, 4163, {"spoilt": 0}), ({}, 4227, {"spoilt": 1}), ({}, 4300, {"spoilt": 2})),  # groups and pages of pages
    *(({}, 4163, {"attribution": "other"}), ({"live": False}, 4163, {})),
])  # fmt: skip
def test_another_package_is_no_growth(before, count, fields):
    with pytest.raises(FormatError, match="expected the package of before with more groups"):
        grown(root(4162, **before), root(count, **fields))


@pytest.mark.parametrize("count", [4162, 4163, 4227, 9000])
def test_growth_may_be_long_in_coming(count):
    assert grown(root(4162), root(count)).offers.manifest.groups.places.groups == count


class Live:
    """A package that gains one group again and again, as fast as it plays, and a link to it; media are only told of.

    Every batch takes a tenth of a second; tables count as an HTTP server sends them: with headers, packed, and not
    again where nothing has changed.
    """

    rtt_s, pipelines = 0.1, False

    def __init__(self, m, seconds):
        now, m = datetime(2026, 1, 1, tzinfo=UTC), replace(m, live=True, groups=faces.Groups.of(m.groups[:1]))
        self.group, self.seconds, self.frames = m.groups[0], seconds, m.groups[0].stop
        self.files, m = faces.Memory("day"), replace(m, frames=self.frames)
        faces.write_tables(self.files, m, faces.LiveClock(now, now))
        self.package = faces.GrowingPackage(self.files, m, now)
        self.tables, self.table_bytes, self.root = RemoteTables(), 0, b""
        self.bring(JSON_NAME)

    def player(self):
        """A player of the best rung whose events are yet to be asked for."""
        offers, rules = self.tables.offers, SessionSettings(decode_frame_s=0.0)
        parts = player.Playout(rules), player.TableStore(offers)
        return player.Player(offers, self, faces.make_policy("fixed:0", offers), rules, *parts)

    def publish_until(self, at_s):
        m = self.package.manifest
        while (start := self.package.manifest.frames) + self.frames <= min(at_s, self.seconds) * m.fps:
            segments = [replace(s, start=s.start + start, stop=s.stop + start) for s in self.group.segments]
            self.package.add(replace(self.group, start=start, stop=start + self.frames, segments=segments))
        if at_s >= self.seconds and m.live:
            self.package.close()

    def bring(self, path):
        data = self.files.read(path)
        self.table_bytes += 350 + (0 if path == JSON_NAME and data == self.root else len(gzip.compress(data)))
        self.root = data if path == JSON_NAME else self.root
        self.tables.accept(path, data)

    def fetch(self, request, give_up=None):
        self.publish_until(request.sent_s)
        for path in request.batch.tables:
            if path != faces.POSTER_NAME:
                self.bring(path)
        at_s = request.sent_s + self.rtt_s
        return faces.Arrival(request, at_s, at_s, 1000, request.batch.files, {}, False)


def remembered(package, viewer):
    """How many of each thing publisher, tables and player know."""
    known = {"tables of the publisher": package.manifest.groups._known, "names": viewer.tables._paths}
    known |= {"keyframes": viewer.decoded(0)}
    known |= {"downloads": viewer.downloads, "timeline": viewer.playout.timeline}
    return {name: len(things) for name, things in known.items()}


def test_hours_of_live_publishing_and_a_viewer_who_stays_end_flat():
    """A group every minute, of which a hundred are remembered."""
    minutes = replace(open_package(VALID / "paged").manifest, frame_rate=[1, 60], timescale=1, region=region())
    live, shown, asked, seen = Live(minutes, 60 * 400), 0, 0, []
    viewer = live.player()
    for event in viewer.play():
        if isinstance(event, faces.Shown):
            shown += 1
            assert event.rung == 0
        asked += isinstance(event, faces.Arrived) and event.arrival.request.kind is faces.BatchKind.TABLES
        if shown and shown % 50 == 0:
            seen.append(remembered(live.package, viewer))
    assert shown == 400 and not live.package.manifest.live
    assert asked <= 3 * shown  # airgs.json and what it leads to
    for name in seen[0]:
        assert max(s[name] for s in seen) <= 2 * 100, name
        assert max(s[name] for s in seen[-3:]) <= 1.2 * max(s[name] for s in seen[:3]) + 4, name
    assert all(len(live.files.read(name)) <= 10_000 for name in (JSON_NAME, faces.MPD_NAME))


def test_tables_of_a_growing_package_are_a_twentieth_of_its_media(demo_package):
    """A third of a minute of the demo scene, whose groups have five frames."""
    live, media = Live(open_package(demo_package).manifest, 20.0), 0
    for event in live.player().play():
        if isinstance(event, faces.Arrived):
            batch = event.arrival.request.batch
            media += sum(live.tables.offers.file_bytes(path) for path in (*batch.keyframes, *batch.delta))
    assert media > 0 and live.table_bytes <= 0.05 * media
