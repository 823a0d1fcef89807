"""A player over a growing package: it joins late, goes on as groups appear, and ends with the package."""

import shutil
from dataclasses import replace
from itertools import pairwise

import pytest

from airgs_codec.play import player
from tests.faces import (
    JSON_NAME,
    HttpDownloader,
    HttpSettings,
    SessionSettings,
    Trace,
    TransportError,
    open_package,
    play,
    simulate,
)
from tests.support.faulty import Weather, faultily_serving
from tests.support.growing import Growing
from tests.support.paths import VALID
from tests.support.servers import serving

RULES = SessionSettings(startup_s=0.0, resume_s=0.0, decode_frame_s=0.0)


@pytest.fixture(autouse=True)
def no_waiting(monkeypatch):
    monkeypatch.setattr(player, "POLL_S", 0.0)


def play_growing(growing, weather=None, rules=RULES):
    http = HttpSettings(as_fast=True, backoff_s=0.001)
    with (
        faultily_serving(growing.folder, weather or Weather(0.0)) as port,
        HttpDownloader(f"http://127.0.0.1:{port}", http, growing.received) as downloader,
    ):
        return play(downloader.open(), downloader, "fixed:0", rules)


@pytest.mark.parametrize(
    ("counts", "shown"),
    [
        ((2, 3, 3, 5, 0), [1, 2, 3, 4]),
        ((62, 63, 64, 65, 0), [61, 62, 63, 64]),  # the first page comes into being
        ((62, 65, 0), [61, 62, 63, 64]),
        ((64, 65, 0), [63, 64]),  # the page alone says where the newest group is
        ((65, 0), [64]),
    ],
)
def test_a_session_begins_with_the_newest_group_and_ends_with_the_package(tmp_path, counts, shown):
    log = play_growing(Growing(tmp_path / "p", *counts))
    assert [s.segment for s in log.shown] == shown and all(s.rung == 0 for s in log.shown)
    assert not log.lost and not log.offers.live
    assert all(b.start_s >= a.start_s + a.frames / log.offers.fps - 1e-9 for a, b in pairwise(log.shown))
    assert log.metrics.frames == len(shown)


def test_who_joins_late_fetches_the_base_of_the_newest_group_once(tmp_path):
    """Groups 2 and 3 keep rows of group 1, which is over."""
    log = play_growing(Growing(tmp_path / "p", 2, 3, 0, whole=VALID / "kept"))
    m = open_package(VALID / "kept").manifest
    assert [s.segment for s in log.shown] == [1, 2] and all(s.rung == 0 for s in log.shown)
    assert [g.keeps for g in m.groups] == [None, 1, 1]
    keys = {path for g in range(3) for t in range(m.tiers) for path in m.key_files(g, t, 0)}
    assert log.bytes_by_kind["key"] + log.bytes_by_kind["sidecars"] == m.bytes_of(sorted(keys))


def test_groups_are_looked_for_a_groups_length_after_the_last_time(tmp_path):
    log = play_growing(Growing(tmp_path / "p", 2, 2, 2, 3, 0))
    polls = [f for f in log.fetches if f.position == 1 and f.kind == "tables"]
    roots = [0.0, *(f.request_s for f in polls[:3])]  # then there is a table to fetch
    assert all(b - a >= 1 / 30 - 1e-6 for a, b in pairwise(roots))


def test_an_airgs_json_that_has_not_changed_is_not_sent_again(tmp_path):
    growing, steps = Growing(tmp_path / "p", 2), [2, 2, 3, 0]

    def received(path, data):
        if path == JSON_NAME and steps:
            growing.waiting.append(steps.pop(0))
            growing.publish()

    with (
        serving(growing.folder) as port,
        HttpDownloader(f"http://127.0.0.1:{port}/p", HttpSettings(backoff_s=0.001), received) as downloader,
    ):
        log = play(downloader.open(), downloader, "fixed:0", RULES)
    sizes = [f.bytes for f in log.fetches if f.kind == "tables" and f.files == 1]
    whole = (growing.folder / JSON_NAME).stat().st_size
    assert [s.segment for s in log.shown] == [1, 2]
    assert max(sizes[1:]) < whole and min(sizes) < 700  # packed, or a head alone


def test_what_waits_is_shown_when_nothing_follows(tmp_path):
    """There is less media than playing begins with."""
    log = play_growing(Growing(tmp_path / "p", 2, 3, 0), rules=replace(RULES, startup_s=60.0, buffer_s=100.0))
    assert [s.segment for s in log.shown] == [1, 2] and log.shown[0].start_s >= log.fetches[-1].arrival_s


def test_a_package_that_stops_growing_ends_the_session(tmp_path, monkeypatch):
    monkeypatch.setattr(player, "SILENCE_S", 0.1)
    log = play_growing(Growing(tmp_path / "p", 2, 3))
    assert [s.segment for s in log.shown] == [1, 2] and "no group has followed" in log.lost[-1]


def test_another_package_in_its_place_is_not_taken_for_more_of_it(tmp_path, monkeypatch):
    monkeypatch.setattr(player, "SILENCE_S", 0.1)
    growing = Growing(tmp_path / "p", 2)
    growing.received = lambda path, data: shutil.copy(VALID / "live" / JSON_NAME, growing.folder / JSON_NAME)
    log = play_growing(growing)
    assert [s.segment for s in log.shown] == [1] and any("another" in line for line in log.lost)


def test_faults_are_survived_while_it_grows(tmp_path):
    growing = Growing(tmp_path / "p", *range(50, 66), 0)
    log = play_growing(growing, Weather(0.2, {"drop": 1.0, "truncation": 1.0, "wrong bytes": 1.0}))
    assert [s.segment for s in log.shown] == list(range(49, 65)) and log.retried


def test_without_its_pages_a_growing_package_cannot_go_on(tmp_path):
    growing = Growing(tmp_path / "p", 62, 64, 65, 0)

    def received(path, data):
        Growing.received(growing, path, data)
        (growing.folder / "index/1/1.json").unlink(missing_ok=True)

    growing.received = received
    with pytest.raises(TransportError, match=r"index/1/1\.json"):
        play_growing(growing)


def test_a_simulated_session_plays_what_there_is(tmp_path):
    growing = Growing(tmp_path / "p", 3)
    log = simulate(open_package(growing.folder), Trace.open("const:9"), "fixed:0", replace(RULES, loops=1))
    assert [s.segment for s in log.shown] == [0, 1, 2]
