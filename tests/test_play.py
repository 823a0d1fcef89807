"""Traces, the link, Algorithm 1 and sessions: answers that can be worked out by hand."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import Bounds, LinearConstraint, milp

from airgs_codec.errors import ConfigError, TransportError
from airgs_codec.manifest import parse_manifest
from airgs_codec.play.link import Link
from airgs_codec.play.policy import Download, PlayerState, budget_bytes, estimate_throughput, parse_policy
from airgs_codec.play.report import write_report
from airgs_codec.play.select import Ladder, Point, select
from airgs_codec.play.session import SessionSettings, metrics, screen_ticks, simulate
from airgs_codec.play.trace import Trace, read_trace
from tests.scenes import FOX

TABLES = Path(__file__).parent / "golden" / "fox" / "airgs.json"


def trace(*pairs, duration=None, name="t"):
    starts, rates = zip(*pairs, strict=True)
    return Trace(name, np.array(starts, float), np.array(rates, float), duration or starts[-1] + 1.0)


def test_download_waits_out_an_outage():
    t = trace((0, 8e6), (1, 0), (5, 8e6), duration=10)
    assert t.arrival_s(2_000_000, 0.0) == 6.0
    assert t.arrival_s(1_000_000, 0.0) == 1.0
    assert t.arrival_s(1, 3.0) == pytest.approx(5.0 + 1e-6)


def test_a_trace_begins_again_when_it_ends():
    t = trace((0, 8e6), (1, 0), duration=2)
    assert t.arrival_s(1_500_000, 0.0) == 2.5
    assert t.arrival_s(3_000_000, 0.0) == 5.0
    assert t.bits_until(5.0) == 24e6
    assert t.mean_bps == 4e6


@given(
    st.lists(st.floats(0, 1e7), min_size=1, max_size=8).filter(lambda r: max(r) > 1e3),
    st.integers(1, 10**6),
    st.floats(0, 30),
)
def test_arrival_is_the_inverse_of_the_integral(rates, size, at):
    t = trace(*enumerate(rates))
    done = t.arrival_s(size, at)
    assert done >= at
    assert t.bits_until(done) - t.bits_until(at) == pytest.approx(8 * size, rel=1e-6, abs=1)


@given(st.lists(st.floats(1, 1e7), min_size=2, max_size=8), st.floats(0, 1.9), st.integers(1, 10**5))
def test_an_offset_begins_inside_the_trace(rates, offset, size):
    t = trace(*enumerate(rates))
    assert t.cut(offset).arrival_s(size, 0.0) == pytest.approx(t.arrival_s(size, offset) - offset, rel=1e-6, abs=1e-6)
    assert t.cut(offset, 2.0).mean_bps == pytest.approx(2 * t.mean_bps)


def test_raca_rows_of_a_second_are_averaged_gaps_hold_and_dashes_are_skipped(tmp_path):
    rows = ["2018.01.01_10.00.00,1000", "2018.01.01_10.00.00,3000", "2018.01.01_10.00.01,-", "2018.01.01_10.00.03,500"]
    (tmp_path / "a.csv").write_text("Timestamp,DL_bitrate\n" + "\n".join(rows))
    t = read_trace(tmp_path / "a.csv")
    assert t.starts_s.tolist() == [0, 3] and t.rates_bps.tolist() == [2e6, 5e5] and t.duration_s == 4


def test_plain_and_mahimahi_traces(tmp_path):
    (tmp_path / "plain.csv").write_text("time_s,mbps\n0,1\n2,0.5\n")
    t = read_trace(tmp_path / "plain.csv")
    assert (t.starts_s.tolist(), t.rates_bps.tolist(), t.duration_s) == ([0, 2], [1e6, 5e5], 4)
    (tmp_path / "mm").write_text("1\n1\n4\n")
    t = read_trace(tmp_path / "mm")
    assert t.duration_s == pytest.approx(4e-3)
    assert t.arrival_s(3000, 0.0) == pytest.approx(1e-3)
    assert t.arrival_s(4500, 0.0) == pytest.approx(4e-3)


def test_the_embedded_trace_is_read():
    t = read_trace(FOX / "trace.csv")
    assert 300 < t.duration_s < 1200 and 1e6 < t.mean_bps < 1e7


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("", "empty"),
        ("hello world\nthis is no trace\n", "expected Raca CSV"),
        ("0,1\n0,2\n", "ascend"),
        ("0,nan\n", "finite"),
        ("0,-3\n", "finite rates of 0 or more"),
        ("0,0\n1,0\n", "zero all the time"),
        ("Timestamp,DL_bitrate\n2018.01.01_10.00.00,-\n", "no DL_bitrate"),
        ("5\n3\n", "ascend"),
    ],
)
def test_a_trace_that_cannot_be_used_is_refused_in_one_line(tmp_path, content, says):
    (tmp_path / "bad").write_text(content)
    with pytest.raises(TransportError, match=says) as caught:
        read_trace(tmp_path / "bad")
    assert "bad" in str(caught.value) and "\n" not in str(caught.value)


def test_a_missing_trace_is_refused(tmp_path):
    with pytest.raises(TransportError, match="cannot read"):
        read_trace(tmp_path / "none")


def test_a_batch_pays_one_round_trip_and_headers_for_each_file():
    link = Link(trace((0, 8e6), duration=100), 0.1, 500)
    assert link.arrival_s([9_500, 89_500], 1.0) == pytest.approx(1.1 + 0.1)


# Algorithm 1


def points(*pairs, step=0.1):
    return [Point(i, size, quality, i * step) for i, (size, quality) in enumerate(pairs)]


def levels(ladder):
    return [p.level for p in ladder.points]


CASES = {
    "1 first drop zero": ([(100, 40), (90, 40), (80, 39.9)], {}, [1, 2]),
    "2 plateau, then a cliff": ([(100, 40), (90, 39.9), (80, 39.9), (70, 30)], {}, [0, 2]),
    "3 tiny first drop": ([(100, 40), (90, 39.999), (80, 39.95), (70, 39.86)], {}, [0, 1, 2, 3]),
    "4 quality rises when pruning": ([(100, 38), (90, 39), (80, 38.9)], {}, [1, 2]),
    "5 slow slide, floor": ([(100, 40), (90, 38), (80, 36), (70, 34), (60, 32)], {"min_quality": 35}, [0, 1, 2]),
    "6 the first level falls off": ([(100, 40), (90, 30), (80, 29)], {}, [0]),
    "9 sizes that do not fall": ([(100, 40), (120, 39), (80, 38.5)], {}, [0, 2]),
    "10 one level": ([(100, 40)], {}, [0]),
    "11 infinite quality": ([(100, math.inf), (90, 99.5), (80, 99.0)], {}, [0, 1, 2]),
    "a cliff": ([(100, 40), (90, 39.5), (80, 39), (70, 34), (60, 33.8)], {}, [0, 1, 2]),
}


@pytest.mark.parametrize("name", CASES)
def test_ladders(name):
    pairs, options, expected = CASES[name]
    assert levels(Ladder.build(points(*pairs), **options)) == expected


def test_drops_count_per_ten_percent_pruned():
    coarse = [Point(0, 100, 40, 0.0), Point(1, 60, 35, 0.3)]  # 5 dB over three tenths
    assert levels(Ladder.build(coarse)) == [0, 1]


def test_ladders_that_make_no_sense_are_refused():
    with pytest.raises(ConfigError, match="at least one"):
        Ladder.build([])
    with pytest.raises(ConfigError, match="level 1"):
        Ladder.build(points((10, 40), (9, math.nan)))
    with pytest.raises(ConfigError, match="more than 1"):
        Ladder.build(points((10, 40)), beta=1.0)


@pytest.mark.parametrize(
    ("budget", "level", "fits"),
    [
        (1000, 0, True),
        (100, 0, True),
        (99, 1, True),
        (80, 2, True),
        (79, 2, False),
        (-5, 2, False),
        (math.nan, 2, False),
    ],
)
def test_selection(budget, level, fits):
    decision = select(Ladder.build(points((100, 40), (90, 39.5), (80, 39))), budget)
    assert (decision.level, decision.fits) == (level, fits)


some_points = st.lists(st.tuples(st.integers(0, 10**6), st.floats(0, 60)), min_size=1, max_size=12).map(
    lambda pairs: points(*pairs)
)


@given(some_points, st.floats(-10, 2e6), st.floats(-10, 2e6))
def test_selection_is_total_monotone_and_never_over_budget(choices, a, b):
    ladder = Ladder.build(choices)
    low, high = (select(ladder, budget) for budget in sorted((a, b)))
    for budget, decision in zip(sorted((a, b)), (low, high), strict=True):
        assert decision.level in levels(ladder)
        assert not decision.fits or decision.size_bytes <= budget
    quality = {p.level: p.quality for p in ladder.points}
    assert quality[low.level] <= quality[high.level]


@given(some_points, st.floats(0, 2e6))
def test_selection_is_the_papers_optimum_where_one_exists(choices, budget):
    """The paper's ILP for one frame: maximise quality, one level, within the budget."""
    ladder = Ladder.build(choices, beta=math.inf, cliff_db=math.inf)
    decision = select(ladder, budget)
    sizes, values = [p.size_bytes for p in choices], [p.quality for p in choices]
    constraints = [LinearConstraint([sizes], ub=budget), LinearConstraint([[1] * len(sizes)], 1, 1)]
    best = milp([-v for v in values], constraints=constraints, bounds=Bounds(0, 1), integrality=[1] * len(sizes))
    assert decision.fits == best.success
    if best.success:
        assert choices[decision.level].quality == pytest.approx(-best.fun, abs=1e-6)


def test_throughput_is_the_smaller_average_and_budget_has_the_papers_form():
    assert estimate_throughput([]) == 0
    steady = (Download(1_000_000, 1.0),) * 5
    assert estimate_throughput(steady) == pytest.approx(8e6)
    falling = (*steady, Download(100_000, 1.0))
    assert 0.8e6 < estimate_throughput(falling) < 8e6
    state = PlayerState(10.0, 10.0, 1.0, 0.1, steady, 2, ())
    assert budget_bytes(state) == pytest.approx(0.9 * 1e6 * 0.9 - 700)
    assert budget_bytes(dataclasses.replace(state, deadline_s=14.0)) == pytest.approx(0.9 * 1e6 * 1.9 - 700)


@pytest.mark.parametrize("text", ["", "best", "fixed", "fixed:9", "fixed:-1", "fixed:x"])
def test_unknown_policies_are_refused(text):
    with pytest.raises(ConfigError, match="policy"):
        parse_policy(text, 4)


# Sessions


@pytest.fixture(scope="module")
def manifest():
    return parse_manifest(TABLES.read_text())


def play(m, mbps, **settings):
    link = Link(trace((0, mbps * 1e6), duration=1000), 0.05)
    return simulate(m, 5000, link, SessionSettings(**settings))


def test_a_fast_link_shows_the_best_rung_without_a_stall(manifest):
    log = play(manifest, 1000)
    result = metrics(log)
    assert result["stalls"] == 0 and set(result["rungs"]) == {"Q0+L0"}
    assert result["frames"] == manifest.frames * round(30 / float(manifest.frames / manifest.fps))
    first = log.fetches[:2]
    assert [f.kind for f in first] == ["manifests", "group"]
    assert result["startup_s"] == pytest.approx(first[1].arrival_s + 0.004)


def test_a_slow_link_takes_the_smallest_rung_and_stalls(manifest):
    result = metrics(play(manifest, 0.2, loops=3))
    assert set(result["rungs"]) == {"Q1+L1"} and result["stall_ratio"] > 0.5


def test_startup_and_stalls_worked_out_by_hand(manifest):
    """At 1 Mbit/s every batch takes its RTT plus its bytes; each segment plays when it is there."""
    log = play(manifest, 1.0, policy="fixed", fixed_level=0, loops=1, decode_frame_s=0.0)
    m, now = manifest, 0.05 + 8 * (5000 + 350) / 1e6
    ready = []
    for s, segment in enumerate(m.segments):
        files = m.state_files(s, 0) + [f for t in range(m.tier_count) for f in m.key_files(segment.group, t, 0)]
        files += m.init_files(0, 0) if s == 0 else []
        now += 0.05 + 8 * (m.bytes_of(files) + 350 * len(files)) / 1e6
        ready.append(now)
    assert [s.ready_s for s in log.shown] == pytest.approx(ready)
    second = max(ready[1], ready[0] + log.shown[0].frames / float(m.fps))
    assert log.shown[1].start_s == pytest.approx(second)
    assert metrics(log)["stall_s"] == pytest.approx(second - ready[0] - log.shown[0].frames / float(m.fps))
    assert sum(metrics(log)["bytes"].values()) == 5000 + m.bytes_of(m.rung_files(0, 0))


def test_the_buffer_never_exceeds_its_cap(manifest):
    log = play(manifest, 1000, buffer_s=1.0)
    fps = float(manifest.fps)
    for i, fetch in enumerate(f for f in log.fetches if f.kind != "manifests"):
        at_hand = sum(s.frames for s in log.shown[: i + 1]) / fps
        played = sum(min(max(fetch.request_s - s.start_s, 0), s.frames / fps) for s in log.shown[:i])
        assert at_hand - played <= 1.0 + 1e-9


def test_sessions_are_deterministic(manifest):
    a, b = (play(manifest, 0.7) for _ in range(2))
    assert a.fetches == b.fetches and a.shown == b.shown


def test_frozen_ticks_count(manifest):
    log = play(manifest, 0.2, loops=2)
    frozen = sum(round(s.stall_s * float(manifest.fps)) for s in log.shown[1:])
    assert len(screen_ticks(log)) == sum(s.frames for s in log.shown) + frozen


def test_an_unmeasured_package_can_only_be_played_at_fixed_levels(manifest):
    views = dataclasses.replace(manifest.views, reference="none")
    bare = dataclasses.replace(manifest, views=views)
    with pytest.raises(ConfigError, match="no measured quality"):
        play(bare, 1.0)
    assert play(bare, 1.0, policy="fixed").shown


def test_the_report_has_its_pictures(manifest, tmp_path):
    page = write_report(play(manifest, 0.7), tmp_path / "r")
    assert page.exists() and (tmp_path / "r" / "session.png").stat().st_size > 20_000
    assert "stalls" in page.read_text()
