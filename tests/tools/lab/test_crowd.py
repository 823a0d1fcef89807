"""A crowd behind one edge: the parts against closed forms, one viewer against the simulator of sessions, and bytes."""

import math
from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.errors import ConfigError
from airgs_codec.package.package import open_package
from airgs_codec.play.policies.mpc import GRID_POINTS, Model
from airgs_codec.play.session import simulate
from airgs_codec.play.settings import SessionSettings
from airgs_codec.play.trace import Link, Trace
from tools.lab.crowd.edge import Edge, EqualShares, LruCache, replay
from tools.lab.crowd.figures import cache_rows, edge_row, jain, policy_rows
from tools.lab.crowd.links import Flows, SharedLink, Traces, water_level
from tools.lab.crowd.policies import crowd_policy, value_before
from tools.lab.crowd.programme import Programme
from tools.lab.crowd.simulation import CrowdSettings, draw_guests, run_crowd

SMALL = CrowdSettings(viewers=24, join_s=3.0, watch_s=4.0, late=0.25, origin_bps=5e7, cache_bytes=1e6)


@pytest.fixture(scope="module")
def programme(demo_package):
    return Programme(open_package(demo_package), 8.0)


@pytest.fixture(scope="module")
def traces():
    return [Trace.open("markov:1:4"), Trace.open("markov:2:2"), Trace.open("const:3")]


@pytest.fixture(scope="module")
def outcome(programme, traces):
    return run_crowd(programme, traces, replace(SMALL, bottleneck_bps=2e7, policies=("robust-mpc", "bola")))


@pytest.mark.parametrize("policy", ["robust-mpc", "throughput", "bola", "paper", "fixed:0"])
@pytest.mark.parametrize("mean_mbps", [1.0, 3.0])
def test_a_viewer_alone_has_the_session_of_the_simulator(programme, policy, mean_mbps):
    trace = [Trace.open(f"markov:7:{mean_mbps:g}")]
    settings = CrowdSettings(1, (policy,), 2.0, 6.0, 0.0, origin_bps=1e30, origin_rtt_s=0.0, seed=3)
    (seen,) = run_crowd(programme, trace, settings).seen
    (guest,) = draw_guests(settings, trace)
    link = Link(trace[0].cut(guest.offset_s), settings.rtt_s)
    metrics = simulate(programme.visit(guest.join_s, settings.watch_s), link, policy).metrics
    assert (seen.wire_bytes, seen.replaced, seen.abandoned) == (
        metrics.wire_bytes,
        metrics.replaced,
        metrics.abandoned,
    )
    assert seen.startup_s == pytest.approx(metrics.startup_s, abs=1e-9)
    assert seen.stall_s == pytest.approx(metrics.stall_s, abs=1e-9) and seen.stalls == metrics.stalls
    assert (seen.psnr_mean, seen.psnr_p5) == (metrics.psnr_mean, metrics.psnr_p5)


def test_every_byte_of_the_edge_is_some_viewers(outcome):
    got = sum(seen.wire_bytes for seen in outcome.seen)
    rounding = sum(seen.requests for seen in outcome.seen)  # of a batch to whole bytes
    assert got == pytest.approx(outcome.passed_bytes, abs=rounding)
    assert sum(second.egress_bytes for second in outcome.seconds) == pytest.approx(outcome.passed_bytes)
    tally = outcome.edge.tally
    assert tally.requests == sum(seen.requests for seen in outcome.seen)
    assert tally.hits + tally.joined + tally.origin_requests == tally.requests
    assert 0 < tally.origin_bytes < tally.bytes


def test_the_shared_link_is_full_and_no_fuller(outcome):
    per_second = [8 * second.egress_bytes for second in outcome.seconds]
    assert max(per_second) <= 2e7 * 1.02  # a tick's worth more or less
    assert max(per_second) >= 2e7 * 0.95


def test_the_same_seed_is_the_same_crowd(programme, traces, outcome):
    assert run_crowd(programme, traces, outcome.settings).seen == outcome.seen
    other = run_crowd(programme, traces, replace(outcome.settings, seed=2))
    assert other.seen != outcome.seen


def test_less_room_means_less_quality(programme, traces):
    wide = policy_rows(run_crowd(programme, traces, SMALL))[0]
    tight = policy_rows(run_crowd(programme, traces, replace(SMALL, bottleneck_bps=1e7)))[0]
    assert tight["psnr"] < wide["psnr"] and tight["mbps"] < wide["mbps"]


def test_figures_of_policies_and_of_all(outcome):
    bola, both = policy_rows(outcome)[1:]
    assert (bola["policy"], bola["viewers"], both["policy"], both["viewers"]) == ("bola", 12, "all", 24)
    assert 1 / 24 < both["jain_bitrate"] <= 1 and both["startup_p50_s"] <= both["startup_p95_s"]
    assert edge_row(outcome)["busy_edge_mbps"] <= 20 * 1.02


@pytest.mark.parametrize(
    ("caps", "capacity", "level"),
    [
        ([1, 2, 9, 9], 12, 4.5),  # 1 and 2 have what they can take, the others half of the rest
        ([1, 2, 9, 9], 21, math.inf),
        ([5, 5, 5], 6, 2),
        ([0, 8], 6, 6),
        ([3, 4], 0, 0),
    ],
)
def test_the_level_is_max_min_fair(caps, capacity, level):
    assert water_level(np.array(caps, np.float64), float(capacity)) == level


def test_nobody_can_have_more_without_taking_from_who_has_less():
    random = np.random.default_rng(0)
    for _ in range(50):
        caps, capacity = random.exponential(5, 20), random.uniform(5, 60)
        rates = np.minimum(caps, water_level(caps, capacity))
        assert rates.sum() == pytest.approx(min(capacity, caps.sum()))
        limited = rates < caps - 1e-9
        assert np.ptp(rates[limited]) < 1e-9 if limited.any() else True
        assert not limited.any() or rates.max() <= rates[limited].min() + 1e-9


def test_flows_behind_a_shared_link_end_when_max_min_fairness_says():
    slow, fast = (Trace(name, np.zeros(1), np.array([rate]), 10.0) for name, rate in (("a", 1e6), ("b", 9e6)))
    flows = Flows.idle(np.array([0, 1, 1]), np.zeros(3))
    link = SharedLink(flows, Traces.of([slow, fast]), 5e6, 0.01)
    flows.left_bits[:] = [1e6, 2e6, 4e6]  # 1 Mbit/s for a; 2 each for the others, and 4 when one of them is through
    ends = {}
    for tick in range(200):
        for viewer in link.tick(0.01 * tick):
            ends[int(viewer)] = float(flows.at_s[viewer])
    assert ends == {0: pytest.approx(1.0, abs=0.02), 1: pytest.approx(1.0, abs=0.02), 2: pytest.approx(1.4, abs=0.02)}
    assert link.passed_bits == pytest.approx(7e6)


def test_transfers_of_the_origin_share_equally():
    link = EqualShares(8e6)  # a million bytes a second
    link.start("long", 1_000_000, 0.0)
    link.start("short", 250_000, 0.5)  # each half from here: short has its 250,000 after another half second
    assert (link.next_s(), link.finish()) == (pytest.approx(1.0), "short")
    assert (link.next_s(), link.finish()) == (pytest.approx(1.25), "long")
    assert link.next_s() == math.inf


def test_the_cache_drops_what_was_not_used_for_longest_and_keeps_nothing_too_large():
    cache = LruCache(100)
    for path, size in (("a", 40), ("b", 40), ("huge", 101)):
        cache.put(path, size)
    assert cache.has("a") and not cache.has("huge")
    cache.put("c", 40)
    assert ("a" in cache, "b" in cache, "c" in cache, cache.bytes) == (True, False, True, 80)


def test_one_fetch_for_all_who_wait_and_the_root_is_checked_each_time():
    edge = Edge(LruCache(1e6))
    assert [edge.ask("key/T0/1.bin", 500, viewer) for viewer in range(3)] == [500, None, None]
    assert edge.arrived("key/T0/1.bin") == [0, 1, 2]
    assert edge.ask("key/T0/1.bin", 500, 3) == 0
    assert edge.ask("airgs.json", 900, 0) == 900
    assert edge.arrived("airgs.json") == [0]
    assert edge.ask("airgs.json", 900, 1) == 350  # headers: it has not changed
    assert (edge.tally.hits, edge.tally.joined, edge.tally.checks) == (1, 2, 1)
    assert (edge.tally.origin_requests, edge.tally.origin_bytes) == (3, 500 + 900 + 350)


def test_replayed_caches_agree_with_the_cache_itself():
    random = np.random.default_rng(1)
    sizes = random.integers(1, 50, 60)
    log = (60 * random.random(3000) ** 2).astype(np.int32)
    for capacity in (0, 30, 200, 700, 10_000):
        cache, missed = LruCache(capacity), []
        for file in log.tolist():
            if not cache.has(str(file)):
                missed.append(int(sizes[file]))
                cache.put(str(file), int(sizes[file]))
        assert replay(log, sizes, float(capacity)) == (len(missed), sum(missed))


def test_a_larger_cache_never_misses_more(outcome):
    rows = cache_rows(outcome, (0.01, 0.1, 1, 10))
    hits = [row["byte_hit_rate"] for row in rows]
    assert hits == sorted(hits) and hits[0] < hits[-1] < 1


def test_the_compiled_step_is_the_same_to_the_bit():
    random = np.random.default_rng(2)
    for before in (1, 6):
        model = Model(2e6, 0.08, 10.0, np.linspace(0.0, 10.0, GRID_POINTS))
        sizes = random.integers(0, 400_000, (before, 6))
        sizes[:, 2], value = 0, random.uniform(0, 300, (6, GRID_POINTS))
        quality, earlier = random.uniform(30, 45, 6), random.uniform(30, 45, 6)
        words = (sizes, quality, earlier, 0.5, value)
        assert np.array_equal(value_before(model, *words), model.value_before(*words))


def test_fairness_of_jain():
    assert jain([3, 3, 3]) == pytest.approx(1) and jain([1, 0, 0, 0]) == 0.25 and jain([0, 0]) == 1


def test_the_programme_repeats_the_package_as_files_of_its_own(programme, demo_package):
    m, long = open_package(demo_package).manifest, programme.whole.manifest
    assert long.frames == 20 * m.frames and len(long.groups) == 20 * len(m.groups)
    again = len(m.groups)
    assert long.key_files(again, 0, 0) != long.key_files(0, 0, 0)
    assert long.bytes_of(long.key_files(again, 0, 0)) == m.bytes_of(m.key_files(0, 0, 0))
    visit = programme.visit(1.0, 2.0)
    assert sum(visit.seconds_at(position) for position in range(visit.end(1))) == pytest.approx(2.0, abs=0.25)
    assert programme.visit(1e9, 2.0).end(1) == 1


@pytest.mark.parametrize("wrong", [{"viewers": 0}, {"tick_s": 0.0}, {"late": 2.0}, {"bottleneck_bps": -1.0}])
def test_settings_that_cannot_be_are_refused(wrong):
    with pytest.raises(ConfigError):
        CrowdSettings(**wrong)


def test_a_policy_that_knows_the_trace_is_refused(programme):
    with pytest.raises(ConfigError, match="oracle-lp"):
        crowd_policy("oracle-lp", programme.whole)


def test_settings_of_players_reach_the_players(programme, traces):
    plain = run_crowd(programme, traces, SMALL)
    patient = run_crowd(programme, traces, replace(SMALL, session=SessionSettings(startup_s=3.0)))
    assert np.mean([s.startup_s for s in patient.seen]) > np.mean([s.startup_s for s in plain.seen])
