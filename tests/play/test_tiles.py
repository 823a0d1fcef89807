"""Packages in tiles: what they cost, and players that fetch the tiles that their viewers are expected to see."""

import dataclasses
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from airgs_codec.play.bound import Horizon, Slot, solve_horizon
from airgs_codec.play.buffered import Buffered
from airgs_codec.play.downloader import Arrived, BatchKind, Request, TileReady
from airgs_codec.play.ladder import Decision, Option
from airgs_codec.play.offers import NONE, Batch, Offers
from airgs_codec.play.playout import Slot as Segment
from airgs_codec.play.playout import tile_of
from airgs_codec.play.report.session import format_metrics, write_report
from airgs_codec.play.session import simulate
from airgs_codec.play.settings import SessionSettings
from airgs_codec.play.trace import Trace
from tests.support.manifests import missing, tiny_manifest
from tests.support.tiled import Turning, tiled_manifest

TILES = 8  # 45 degrees apart; a picture of 60 degrees shows the one in its middle
SHORT = {"groups": (30,) * 3, "fps": (30, 1)}
SCENE = {"groups": (30,) * 8, "fps": (30, 1)}
STILL = Turning()


def play(m, rate="const:10", policy="fixed:0", view=None, **options):
    rules = SessionSettings(**({"loops": 1} | options))
    return simulate(Offers(m, 0, 1000), Trace.open(rate), policy, rules, view=view)


def fetched(log):
    """Tiles that came, by position."""
    return [{event.tile for event in log.tiles.came(position)} for position in range(len(log.shown))]


def test_numbers_are_those_of_all_tiles():
    one, offers = Offers(tiled_manifest(1), 0).offer(0), Offers(tiled_manifest(4), 0)
    four = offers.offer(0)
    assert four.sizes(NONE) == [4 * size for size in one.sizes(NONE)]
    assert [rung.gaussians for rung in four.rungs] == [4 * rung.gaussians for rung in one.rungs]
    batch = four.missing(0, NONE)
    assert len(batch.keys) == 4 * 2 * 2 and len(batch.state) == 4
    assert offers.wire_bytes([offers.file_bytes(path) for path in batch.files]) == four.sizes(NONE)[0]
    assert four.missing(0, frozenset((0, 0, unit) for unit in range(8))).keys == ()


def test_some_tiles_cost_what_they_have():
    four = Offers(tiled_manifest(4, empty=[3]), 0)
    first, second = (four.offer(segment, frozenset({0, 2})) for segment in (0, 1))
    assert first.sizes(NONE) == [size * 2 // 3 for size in four.offer(0).sizes(NONE)]
    assert {tile_of(path) for path in first.missing(0, NONE).files} == {0, 2}
    decoded = frozenset((0, 0, unit) for unit in (0, 1, 4, 5))
    assert second.bytes_after(first, NONE)[0].tolist() == second.sizes(decoded)
    assert four.offer(0, frozenset(range(4))).sizes(NONE) == four.offer(0).sizes(NONE)
    assert four.offer(0, frozenset({3})).sizes(NONE) == [0] * len(four.rungs)


def test_a_package_of_one_tile_is_played_as_ever():
    m = tiny_manifest(**SCENE)
    plain, seen = play(m), play(m, view=STILL)
    assert seen.fetches == plain.fetches and seen.shown == plain.shown and seen.tiles is None
    assert seen.metrics == plain.metrics and seen.settings == plain.settings


@pytest.mark.parametrize("policy", ["fixed:Q1+L1", "robust-mpc", "bola", "oracle-lp"])
def test_all_tiles_cost_what_one_with_all_of_their_bytes_costs(policy):
    """Four tiles of a quarter each are a quarter of four times the rate, with headers of no bytes."""
    four = play(tiled_manifest(4), "const:0.4", policy, loops=8)
    one = play(tiled_manifest(1), "const:0.1", policy, loops=8)
    tables = 1000 + 2 * 100  # those are not four times as large
    assert four.tiles is None and four.metrics.tiles is None
    if policy.startswith("fixed"):
        assert four.metrics.wire_bytes - tables == 4 * (one.metrics.wire_bytes - tables)
    assert [s.rung for s in four.shown[4:]] == [s.rung for s in one.shown[4:]] or policy == "robust-mpc"


def test_the_bound_counts_the_keys_of_all_tiles():
    offer = Offers(tiled_manifest(3), 0).offer(0)
    whole = float(offer.sizes(NONE)[0])
    assert solve_horizon(Horizon((Slot(offer, 0.0, whole),)), integer=True).quality == pytest.approx(40)
    assert solve_horizon(Horizon((Slot(offer, 0.0, whole - 100),)), integer=True).quality < 40


def test_who_does_not_turn_fetches_what_he_sees_and_what_is_beside_it():
    log = play(tiled_manifest(TILES, **SCENE), view=STILL)
    assert set().union(*fetched(log)) == {0, 1, 7}  # within 30 degrees of the picture
    assert log.metrics.tiles.missing_s == 0 and log.metrics.stalls == 0
    assert log.metrics.tiles.bytes[2:7] == (0,) * 5 and min(log.metrics.tiles.bytes[i] for i in (0, 1, 7)) > 0
    assert log.metrics.tiles.fetched == pytest.approx(3 / 8)
    everything = play(tiled_manifest(TILES, **SCENE))
    assert log.metrics.wire_bytes - 2000 < 3 / 8 * everything.metrics.wire_bytes


def test_the_buffer_is_short_where_tiles_are_fetched_by_view():
    log = play(tiled_manifest(TILES, **SCENE), view=STILL)
    for position, s in enumerate(log.shown[4:], 4):
        ask_s = min(f.request_s for f in log.fetches if f.position == position and f.kind is not BatchKind.TABLES)
        assert ask_s >= s.start_s + s.frames / 30 - log.settings.buffer_s - 1e-6
    assert log.settings.buffer_s == SessionSettings().view_buffer_s


@pytest.mark.parametrize("parts", [1, 2, 4])
def test_segments_of_any_length_play_without_a_pause(parts):
    """A segment of a second is as long as the buffer: it must come while the one before is shown."""
    log = play(tiled_manifest(TILES, parts, **SCENE), view=STILL)
    assert log.metrics.stalls == 0 and log.metrics.tiles.missing_s == 0


@pytest.mark.parametrize("degrees", [30, 90, -150])
def test_who_turns_lacks_nothing_on_a_fast_link(degrees):
    log = play(tiled_manifest(TILES, **SCENE), "const:20", view=Turning(degrees, 1.0))
    assert log.metrics.tiles.missing_s == 0 and log.metrics.stalls == 0
    assert set().union(*fetched(log)) == set(range(TILES))
    assert log.metrics.tiles.fetched < 0.75


def test_a_sudden_turn_is_repaired_before_the_next_segment():
    """He turns by a right angle in a fifth of a second: what is then in sight comes first, though it is late."""
    log = play(tiled_manifest(TILES, **SCENE), "const:1", view=Turning(450, 2.0, 2.2))
    turned_s = log.shown[0].start_s + 2.2
    after = [f for f in log.fetches if f.request_s > turned_s - 0.1]
    assert after[0].kind is BatchKind.REPAIR
    on_screen = next(i for i, s in enumerate(log.shown) if s.start_s + s.frames / 30 > turned_s)
    came = {event.tile: event.ready_s for event in log.tiles.came(on_screen)}
    assert came[2] > log.shown[on_screen].start_s
    later = [f.request_s for f in after if f.position > on_screen + 1]
    assert came[2] < min(later)
    assert 0 < log.metrics.tiles.missing_s < 1


def test_what_is_lacking_on_a_slow_link_is_counted():
    slow, fast = (
        play(tiled_manifest(TILES, **SCENE), rate, view=Turning(90, 0.5)) for rate in ("const:0.2", "const:5")
    )
    assert slow.metrics.tiles.missing_s > 1 and fast.metrics.tiles.missing_s == 0
    missing = slow.tiles.missing
    assert missing.any(axis=1).sum() / 30 == pytest.approx(slow.metrics.tiles.missing_s)
    assert len(missing) == len(slow.screen_ticks) == len(slow.tiles.tick_times)


def test_a_repair_that_would_come_too_late_takes_the_smallest_rung():
    m = tiled_manifest(TILES, key_bytes=((30_000, 1000),), state_bytes=(20_000, 500), psnr=[[40.0, 36.0]] * 2, **SCENE)
    log = play(m, "const:2.4", view=Turning(450, 2.0, 2.2))
    rungs = {event.rung for event in log.tiles.ready}
    assert 0 in rungs and log.offers.rungs.index((1, 1)) in rungs


class Asked:
    """A fetcher at 10 s on a link of 1000 bytes a second; tile 3 can be had in rungs of 2000, 500 and 700 bytes."""

    now_s, settings = 10.0, SimpleNamespace(decode_frame_s=0.25)
    options = (Option(0, 2000, 40.0, 0.0), Option(1, 500, 30.0, 0.5), Option(2, 700, 33.0, 0.4))

    def sent_s(self, latency_s):
        return self.now_s - latency_s / 2

    def throughput_bps(self, at_s):
        assert at_s == 9.75
        return 8000.0

    def usable_options(self, position, tiles):
        assert (position, tiles) == (4, frozenset({3}))
        return self.options


@pytest.mark.parametrize(
    ("end_s", "rung"),
    # Waited for half a second, received in 2, 0.5 and 0.7 s, and decoded in a quarter.
    [(12.76, 0), (12.75, 1), (11.26, 1), (11.25, None)],
)
def test_a_repair_comes_in_the_rung_of_its_segment_or_the_smallest_or_not(end_s, rung):
    buffered = Buffered(None, Asked(), None)
    option = buffered._repairing(Segment(4, 1.0, 0.0, rung=0, start_s=end_s - 1.0), 3, 0.5)
    assert (option and option.index) == rung
    wanted = buffered._repairing(Segment(4, 1.0, 0.0, rung=2, start_s=20.0), 3, 0.5)
    assert wanted.index == 2


@pytest.mark.parametrize("complete", [True, False])
def test_a_tile_that_is_lacking_is_asked_for_by_itself_until_its_segment_is_over(complete):
    batch, asked, option = Batch(("key",), ("state",)), [], Option(1, 500, 30.0, 0.5)
    arrival = SimpleNamespace(complete=complete)

    class Fetching(Asked):
        def missing(self, position, rung, tiles):
            assert (position, rung, tiles) == (4, 1, frozenset({3}))
            return batch

        def receive(self, request, gives_up):
            asked.append(request)
            here = [SimpleNamespace(at_s=12.0, left_s=left_s) for left_s in (1.0, 1.1)]
            assert [gives_up(partial) for partial in here] == [False, True]
            return arrival
            yield

    buffered, slot = Buffered(None, Fetching(), None), Segment(4, 1.0, 0.0, rung=0, start_s=12.0)
    events = list(buffered._fetch_lacking(slot, 3, option, 0.5))
    assert asked == [Request(BatchKind.REPAIR, 4, 1, batch, 9.75, 0.5)]
    assert events[0] == Arrived(arrival, Decision(1, True, "tile 4 is lacking", 500), 0.0, 8000.0)
    assert events[1:] == ([TileReady(4, 3, 1, 10.25)] if complete else [])
    assert slot.tiles == ({3: 1} if complete else {})
    assert buffered.no_use == (set() if complete else {(4, 3)})


def test_policies_see_the_sizes_of_the_tiles_that_are_chosen():
    """A link that carries three tiles in the best rung, and not eight."""
    m = tiled_manifest(TILES, **SCENE)
    rates = play(m, "const:0.35", "robust-mpc"), play(m, "const:0.35", "robust-mpc", view=STILL)
    best = [np.mean([s.rung == 0 for s in log.shown[6:]]) for log in rates]
    assert best[1] > 0.9 > best[0]


def test_a_tile_without_rows_is_never_fetched():
    log = play(tiled_manifest(TILES, empty=[1, 7], **SCENE), view=STILL)
    assert set().union(*fetched(log)) == {0} and log.metrics.tiles.missing_s == 0


def test_a_missing_file_costs_its_tile_a_rung_and_no_more():
    m = tiled_manifest(TILES, **SCENE)
    path = m.state_files(5, 0, [0])[0]
    log = simulate(Offers(m, 0, 1000), Trace.open("const:10"), "robust-mpc", None, missing(path), STILL)
    assert path in log.lost[0] and log.metrics.lost_frames == 0
    (rung,) = {event.rung for event in log.tiles.came(5) if event.tile == 0}
    assert log.offers.rungs[rung] == (0, 1)


@pytest.mark.parametrize(("gone", "came"), [(0, {1, 15}), (1, {0, 15}), (15, {0, 1})])
def test_a_tile_that_cannot_be_had_costs_no_other_tile(gone, came):
    """Of 16 tiles the picture shows three, the one in the middle first."""
    m = tiled_manifest(16, **SHORT)
    lost = [path for level in range(len(m.levels)) for path in m.state_files(5, level, [gone])]
    log = simulate(Offers(m, 0, 1000), Trace.open("const:10"), "fixed:0", None, missing(*lost), STILL)
    early = {e.tile for e in log.tiles.came(5) if e.ready_s <= log.shown[5].ready_s}
    assert log.metrics.lost_frames == 0 and early == came


def test_tiles_that_can_be_had_in_no_common_rung_each_have_one():
    m = tiled_manifest(16, **SHORT)
    there = {0: 0, 1: 1, 15: 0}  # tile -> the only level of it that can be had
    lost = [
        path
        for tile, level in there.items()
        for j in range(len(m.levels))
        if j != level
        for path in m.state_files(0, j, [tile])
    ]
    log = simulate(Offers(m, 0, 1000), Trace.open("const:10"), "robust-mpc", None, missing(*lost), STILL)
    early = {e.tile: log.offers.rungs[e.rung][1] for e in log.tiles.came(0) if e.ready_s <= log.shown[0].ready_s}
    assert log.metrics.lost_frames == 0 and early == there


@pytest.mark.parametrize("policy", ["fixed:0", "robust-mpc", "bola", "oracle-lp"])
def test_a_scene_without_rows_is_shown_and_not_lost(policy):
    log = play(tiled_manifest(4, empty=range(4)), policy=policy, view=STILL)
    assert log.lost == () and log.metrics.lost_frames == 0 and {s.rung for s in log.shown} == {0}
    assert log.tiles.ready == () and log.metrics.tiles.missing_s == 0 and log.metrics.stalls == 0
    assert {f.kind for f in log.fetches} == {BatchKind.TABLES}


def test_a_rung_that_a_repair_finds_missing_is_chosen_no_more(monkeypatch):
    m = tiled_manifest(16, **SHORT)
    lost, repair = m.state_files(0, 0, [1]), Buffered.repair

    def finding(buffered):
        buffered.fetcher.unusable.update(lost if buffered.fetcher.downloads else ())
        return (yield from repair(buffered))

    monkeypatch.setattr(Buffered, "repair", finding)
    log = play(m, view=STILL)
    early = {e.tile: log.offers.rungs[e.rung][1] for e in log.tiles.came(0) if e.ready_s <= log.shown[0].ready_s}
    assert early[0] == 0 and early[1] != 0 and early[15] != 0


def test_an_offer_is_made_once():
    c = Offers(tiled_manifest(TILES), 0)
    assert c.offer(0, frozenset({1})) is c.offer(0, frozenset({1})) is not c.offer(0, frozenset({2}))


def test_the_log_says_what_is_on_the_screen():
    log = play(tiled_manifest(TILES, **SCENE), "const:0.4", view=Turning(90, 0.5))
    for position, s in enumerate(log.shown):
        before, after = log.tiles.there(position, s.start_s), log.tiles.there(position, s.start_s + s.frames / 30)
        assert before.items() <= after.items() and before
    late = sum(event.ready_s > log.shown[event.position].start_s for event in log.tiles.ready)
    assert late == log.metrics.tiles.late > 0
    assert sum(f.wasted for f in log.fetches) <= 0.05 * log.metrics.wire_bytes


def test_the_report_shows_tiles(tmp_path):
    log = play(tiled_manifest(TILES, **SCENE), "const:0.4", view=Turning(90, 0.5))
    words = format_metrics(log)
    assert f"lacking for {log.metrics.tiles.missing_s:.2f} s" in words and "best possible" not in words
    page = write_report(log, tmp_path).read_text()
    assert "lacking for" in page
    assert dataclasses.asdict(log.metrics)["tiles"]["tiles"] == TILES


def test_a_group_that_keeps_rows_needs_the_units_of_the_same_tiles():
    m = tiled_manifest(2)
    first, second = m.groups
    keeping = replace(m, groups=type(m.groups).of([first, replace(second, keeps=1)]))
    batch = Offers(keeping, 0).offer(2, frozenset({1})).missing(0, NONE)
    assert len(batch.keys) == 2 * 2 * 2 and len(batch.state) == 1
    of_second = {path for unit in (2, 3) for group in (0, 1) for path in keeping.key_files(group, unit, 0)}
    assert set(batch.keys) == of_second
