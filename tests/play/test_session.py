"""Sessions that can be followed with a pencil, and what must hold in any of them."""

import html
import itertools
import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from airgs_codec.package.references import check_root
from airgs_codec.package.tables import Segment
from airgs_codec.play.metrics import SHORTEST_S, session_metrics
from airgs_codec.play.report import write_report
from airgs_codec.play.session import SessionLog
from tests.faces import (
    NONE,
    STALL_DB,
    Arrival,
    Arrived,
    BatchKind,
    ConfigError,
    Decision,
    FileKind,
    FormatError,
    Link,
    Offers,
    Policy,
    Replaced,
    Request,
    SessionSettings,
    Shown,
    Trace,
    answer,
    check_group,
    format_metrics,
    open_package,
    root_of,
    session_bound,
    simulate,
)
from tests.support.manifests import missing, tiny_manifest, with_segments
from tests.support.paths import VALID

BARE = {"startup_s": 0.0, "resume_s": 0.0, "decode_frame_s": 0.0, "loops": 1}
BARE |= {"pipelined": False, "replace": False, "abandon": False}


def link(rates, starts=None, duration=None, rtt=0.0, end="loop"):
    starts = list(range(len(rates))) if starts is None else starts
    trace = Trace("t", np.array(starts, float), np.array(rates, float), float(duration or starts[-1] + 1), end=end)
    return Link(trace, rtt)


def rules(**options):
    return SessionSettings(**(BARE | options))


def play(manifest, over, policy="fixed:0", headers=0, faults=None, **options):
    """A session with 1000 bytes of manifests and the bare rules but for `options`."""
    return simulate(Offers(manifest, headers, 1000), over, policy, rules(**options), faults)


def pairs(log):
    """Key quality, level and PSNR of what was shown."""
    return {(*log.offers.rungs[s.rung], s.psnr) for s in log.shown}


@pytest.mark.parametrize("options", [{}, {"psnr": None}, {"state_bytes": (2000, 1000, 0)}], ids=str)
def test_the_test_manifest_is_a_manifest(options):
    m = tiny_manifest(**options)
    check_root(root_of(m))
    for number, group in enumerate(m.groups):
        check_group(m, m.groups.places.entry(number), group, "group")


def test_a_session_by_hand():
    """10,000 B/s: 1000 B of airgs.json, then for each group 100 of table, and 4000 key + 2100 state + 200 sidecars."""
    log = play(tiny_manifest(), link([8e4]))
    assert [(f.kind, f.bytes) for f in log.fetches] == [
        *(("tables", 1000), ("tables", 100), ("group", 6300), ("tables", 100), ("group", 6300)),
    ]
    assert [f.arrival_s for f in log.fetches] == pytest.approx([0.1, 0.11, 0.74, 0.75, 1.38])
    assert [s.start_s for s in log.shown] == pytest.approx([0.74, 1.74])
    result = log.metrics
    assert result.startup_s == pytest.approx(0.74)
    assert (result.startup_requests, result.startup_table_bytes) == (1 + 1 + 5, 1100)
    assert (result.stalls, result.stall_s, result.switches, result.frames) == (0, 0, 0, 20)
    assert result.bytes == {"manifests": 1200, "key": 8000, "sidecars": 400, "state": 4200}
    assert result.wire_bytes == 13_800
    assert result.psnr_mean == 40.0 and result.delta_e_mean == 0.5
    assert result.trace_mean_bps == 8e4


def test_a_tier_is_fetched_when_a_level_first_needs_it():
    """The last level does with T0; rising in the middle of a group brings T1 along, once."""
    m = segmented(tiny_manifest(groups=(30,), psnr=None))
    m = replace(m, levels=[*m.levels[:2], replace(m.levels[2], tiers=1)])
    low = play(m, link([8e4]), "fixed:2")
    assert low.bytes_by_kind["key"] == 3000 and low.bytes_by_kind["sidecars"] == 100
    high = play(m, link([8e4]))
    assert high.bytes_by_kind["key"] == 4000 and high.bytes_by_kind["sidecars"] == 200


def test_half_the_rate_stalls_and_the_frozen_picture_counts():
    log = play(tiny_manifest(psnr=[[40.0, 0.0]] * 3), link([4e4]))
    assert [f.arrival_s for f in log.fetches] == pytest.approx([0.2, 0.22, 1.48, 1.5, 2.76])
    assert [s.stall_s for s in log.shown] == pytest.approx([0, 0.28])
    ticks = log.screen_ticks
    assert len(ticks) == 23  # 20 frames, 0.28 s of waiting at 10 fps
    assert ticks[10:13] == [(0, 9)] * 3
    assert log.metrics.stall_ratio == pytest.approx(0.28 / 2.28)
    assert log.metrics.qoe == pytest.approx((2 * 40 - STALL_DB * 0.28) / 2)


def test_headers_round_trips_and_decoding_cost_time():
    log = play(tiny_manifest(), link([8e4], rtt=0.1), decode_frame_s=0.05, headers=100)
    # a table is one file; a group has 2 tiers of 2 files and a state
    assert [f.arrival_s for f in log.fetches] == pytest.approx([0.21, 0.33, 1.11, 1.23, 2.01])
    assert log.shown[0].start_s == pytest.approx(1.16)


def test_a_level_with_nothing_to_fetch_costs_only_its_key():
    log = play(tiny_manifest(state_bytes=(2000, 1000, 0)), link([8e4]), "fixed:2")
    assert [f.bytes for f in log.fetches if f.kind == "group"] == [4200, 4200]
    assert log.metrics.bytes.get("state", 0) == 0


@pytest.mark.parametrize("buffer_s", [3.0, 2.5])  # whole segments of a second, and half of one
def test_the_buffer_holds_requests_back(buffer_s):
    log = play(tiny_manifest(), link([8e9]), loops=20, buffer_s=buffer_s)
    begin = log.shown[0].start_s
    for i, fetch in enumerate(f for f in log.fetches if f.kind == "group"):
        assert fetch.request_s >= begin + i + 1 - buffer_s - 1e-9
    assert log.fetches[-1].request_s == pytest.approx(begin + 40 - buffer_s)
    assert log.metrics.stalls == 0


def test_loops_fetch_keys_and_states_again_but_not_tables():
    once, twice = (play(tiny_manifest(), link([8e6]), "fixed:1", loops=n).metrics.bytes for n in (1, 2))
    assert twice == {k: v * (1 if k == "manifests" else 2) for k, v in once.items()}
    default = play(tiny_manifest(), link([8e6]), "fixed:1", loops=None)
    assert default.metrics.played_s == 30.0


def test_key_quality_and_level_are_chosen_together():
    """The first choice has the tables to judge by."""
    rich = play(tiny_manifest(), link([8e7]), "paper-no-cliff")
    poor = play(tiny_manifest(), link([2e4]), "paper-no-cliff")
    assert pairs(rich) == {(0, 0, 40.0)} and rich.shown[1].rung == 0
    assert pairs(poor) == {(1, 2, 32.0)}
    assert "nothing fits" in poor.fetches[-1].reason and "B fit" in rich.fetches[-1].reason
    assert "B fit" in rich.fetches[2].reason


def test_a_faster_link_is_no_worse_however_fast():
    log = play(tiny_manifest(), link([8e18]), "paper-no-cliff")
    assert log.shown[1].rung == 0


def test_paper_needs_measured_quality_everywhere():
    with pytest.raises(ConfigError, match="no measured quality"):
        play(tiny_manifest(psnr=None), link([8e6]), "paper-no-cliff")
    log = play(tiny_manifest(psnr=None), link([8e6]))
    assert log.metrics.psnr_mean is log.metrics.delta_e_mean is None and "not measured" in format_metrics(log)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"buffer_s": 0.0}, "buffer"),
        ({"buffer_s": float("nan")}, "buffer"),
        ({"decode_frame_s": -1.0}, "decoding"),
        ({"decode_frame_s": float("inf")}, "decoding"),
        ({"loops": 0}, "loops"),
        ({"loops": -1}, "loops"),
        ({"policy": "fixed:3"}, "policy"),
        ({"startup_s": -1.0}, "start-up"),
        ({"resume_s": float("inf")}, "resume"),
    ],
)
def test_settings_that_cannot_work(options, words):
    with pytest.raises(ConfigError, match=words):
        play(tiny_manifest(), link([8e6]), **options)


@pytest.mark.parametrize("rtt", [-0.1, float("nan"), float("inf")])
def test_round_trips_that_cannot_be(rtt):
    with pytest.raises(ConfigError, match="round trip"):
        play(tiny_manifest(), link([8e6], rtt=rtt))


def test_playing_begins_when_enough_is_at_hand():
    """0.63 s of download each and 0.01 of tables: the second segment is there at 1.38 s."""
    log = play(tiny_manifest(), link([8e4]), startup_s=1.5)
    assert [s.start_s for s in log.shown] == pytest.approx([1.38, 2.38])
    assert [s.stall_s for s in log.shown] == [0, 0]


def test_it_goes_on_when_enough_is_at_hand_again():
    """Half the rate: the second segment stalls by 0.28 s; with 1.5 s wanted the player waits for the third too."""
    one = play(tiny_manifest(), link([4e4]), loops=2)
    assert [s.stall_s for s in one.shown] == pytest.approx([0, 0.28, 0.26, 0.26])
    two = play(tiny_manifest(), link([4e4]), loops=2, resume_s=1.5)
    assert [s.ready_s for s in two.shown] == pytest.approx([1.48, 2.76, 4.02, 5.28])
    assert [s.start_s for s in two.shown] == pytest.approx([1.48, 4.02, 5.02, 6.02])
    assert [s.stall_s for s in two.shown] == pytest.approx([0, 1.54, 0, 0])
    assert two.shown[-1].start_s + 1 > one.shown[-1].start_s


def test_a_full_buffer_need_not_wait_for_more():
    log = play(tiny_manifest(), link([4e4]), loops=2, resume_s=9.0, startup_s=9.0, buffer_s=2.0)
    assert log.shown[0].start_s == pytest.approx(2.76)  # two segments are all it may hold
    assert len(log.shown) == 4


def test_buffered_segments_are_replaced_by_better_ones_in_time():
    """A slow second, then a fast link: what waits in the buffer is fetched again, the first one is on the screen."""
    quick = {"policy": "paper-no-cliff", "buffer_s": 4.0, "loops": 4}
    m = tiny_manifest()
    kept = play(m, link([3e4, 8e6], [0, 2], 1000), **quick)
    better = play(m, link([3e4, 8e6], [0, 2], 1000), **quick, replace=True)
    replaced = [f for f in better.fetches if f.kind is BatchKind.REPLACEMENT]
    assert replaced and better.mean_quality > kept.mean_quality
    for f in replaced:
        shown = better.shown[f.position]
        assert f.arrival_s <= shown.start_s and shown.rung == f.rung
    assert better.metrics.wasted > 0 == kept.metrics.wasted


def test_a_replacement_that_cannot_be_had_is_asked_for_once():
    faults, quick = missing("key/T0/Q0/1.m4s"), {"buffer_s": 4.0, "loops": 4, "replace": True}
    log = play(tiny_manifest(), link([3e4, 8e6], [0, 2], 1000), "paper-no-cliff", faults=faults, **quick)
    assert [f.rung for f in log.fetches if f.kind is BatchKind.REPLACEMENT and f.position == 2] == [0, 3]


def test_a_better_key_serves_the_rest_of_its_group():
    """Six segments in one group; the first comes with the coarse key, a later one brings the fine one."""
    m = segmented(tiny_manifest(groups=(60,)), 6)
    log = play(m, link([2.4e4, 8e6], [0, 1.2], 1000), "robust-mpc")
    qualities = [log.offers.rungs[s.rung][0] for s in log.shown]
    assert qualities[0] == 1 and qualities[-1] == 0 and qualities == sorted(qualities, reverse=True)
    keys = [f for f in log.fetches if f.kind is BatchKind.GROUP]
    assert len(keys) == 2 and log.metrics.bytes["key"] == 1500 + 4000


def test_a_download_that_would_come_too_late_is_given_up():
    """The link collapses in the middle of a large segment; whole files of it are kept."""
    slow = link([8e4, 4e3, 8e4], [0, 1.0, 9.0], 1000)
    patient = play(tiny_manifest(), slow)
    hasty = play(tiny_manifest(), slow, "paper-no-cliff", abandon=True)
    assert patient.metrics.abandoned == 0 and hasty.metrics.abandoned >= 1
    waited = [log.metrics.startup_s + log.metrics.stall_s for log in (patient, hasty)]
    assert waited[1] < waited[0]
    given_up = next(f for f in hasty.fetches if f.abandoned)
    assert given_up.arrival_s - given_up.request_s >= 0.5 and 0 < given_up.wasted <= given_up.bytes


def test_missing_and_corrupt_files_cost_their_rung_and_no_more():
    m = tiny_manifest()
    whole = play(m, link([8e6]))
    absent = play(m, link([8e6]), "paper-no-cliff", faults=missing("state/L0/2.m4s"))
    assert [log_rung(absent, i) for i in (0, 1)] == ["Q0+L0", "Q0+L1"]
    assert "state/L0/2.m4s" in absent.lost[0] and absent.metrics.lost_frames == 0
    assert absent.metrics.bytes["state"] == 2100 + 1100 and whole.metrics.bytes["state"] == 4200
    broken = {"state/L0/2.m4s": FormatError("hash_mismatch", "state/L0/2.m4s", "the SHA-256 differs")}
    corrupt = play(m, link([8e6]), "paper-no-cliff", faults=broken)
    assert corrupt.fetches[4].bytes == absent.fetches[4].bytes + 2100  # it travels before it can be found wrong
    assert corrupt.fetches[4].wasted > absent.fetches[4].wasted


def test_asking_ahead_hides_the_round_trip():
    """As by hand, with a round trip of 0.1 s: paid for airgs.json, for a table and for the first batch.

    The table of the third group comes with the second batch, so that nothing is waited for.
    """
    log = play(tiny_manifest(groups=(10, 10, 10)), link([8e4], rtt=0.1), pipelined=True)
    assert [f.arrival_s for f in log.fetches] == pytest.approx([0.2, 0.31, 1.04, 1.15, 1.79, 2.42])
    assert [f.request_s for f in log.fetches] == pytest.approx([0, 0.2, 0.31, 1.04, 1.05, 1.69])
    assert [f.files for f in log.fetches] == [1, 1, 5, 1, 6, 5]
    full = play(tiny_manifest(), link([8e9], rtt=0.1), pipelined=True, loops=20, buffer_s=3.0)
    batches = [f for f in full.fetches if f.kind != "tables"]
    for i, fetch in enumerate(batches[4:], 4):  # a full buffer lets nobody ask before there is room
        assert fetch.arrival_s >= full.shown[0].start_s + i + 1 - 3.0 + 0.1 - 1e-6


def test_a_missing_table_costs_its_group_and_no_more():
    m = tiny_manifest(groups=(10, 10, 10))
    for policy in ("paper-no-cliff", "robust-mpc"):
        log = play(m, link([8e6]), policy, faults=missing("group/2.json.gz"))
        assert [s.rung is None for s in log.shown] == [False, True, False] and log.metrics.lost_frames == 10
        assert sum("group/2.json.gz" in line for line in log.lost) == 1


def arrived(kind, rung, sent_s, at_s, **changes):
    """Everything that a rung of the first segment needs, whole after `at_s - sent_s` seconds."""
    batch = OFFERS.offer(0).missing(rung, NONE)
    request = Request(kind, 0, rung, batch, sent_s, 0.0)
    arrival = Arrival(request, sent_s, at_s, 9000, batch.files, {}, abandoned=False)
    return Arrived(replace(arrival, **changes), Decision(rung, True, "", 9000), 0.0, 0.0)


OFFERS = Offers(tiny_manifest(), 0)
BETTER, WORSE = 0, OFFERS.names.index("Q1+L2")
SHOWN = [Shown(0, 0, WORSE, 1.0, 5.0, 10, 0.0, 32.0)]
FIRST = arrived(BatchKind.GROUP, WORSE, 0.0, 1.0)
SECOND = arrived(BatchKind.REPLACEMENT, BETTER, 1.0, 4.0)


def folded(*events):
    return SessionLog.of([*events, *SHOWN], OFFERS, "paper-no-cliff", rules())


def test_a_replacement_is_the_time_and_the_waste_of_what_it_replaced():
    log = folded(FIRST, SECOND, Replaced(0, WORSE, BETTER))
    assert log.frame_times == pytest.approx([0.3] * 10)
    assert [f.wasted for f in log.fetches] == [600, 0]  # the state; keys stay decoded


def test_a_replacement_that_replaced_nothing_is_wasted_and_the_time_of_no_frame():
    """It came too late: frames were on their way as long as the batch that brought them (0.1 s each, not 0.3)."""
    log = folded(FIRST, SECOND)
    assert log.frame_times == pytest.approx([0.1] * 10)
    assert [f.wasted for f in log.fetches] == [0, 9000] and log.metrics.replaced == 1


def test_a_batch_given_up_is_wasted_but_for_its_keys():
    part = FIRST.arrival.request.batch
    log = folded(arrived(BatchKind.GROUP, WORSE, 0.0, 1.0, whole=part.keys, abandoned=True), FIRST)
    assert [f.wasted for f in log.fetches] == [9000 - 2 * 100 - 1000 - 500, 0]
    assert log.metrics.abandoned == 1 and [f.abandoned for f in log.fetches] == [True, False]
    assert log.metrics.bytes["key"] == 2 * 1500 and log.metrics.bytes["state"] == 600


def test_policies_of_ones_own_and_packages_are_taken_as_they_are():
    smallest = Policy("smallest", lambda s: Decision(WORSE, True, "mine", s.options[WORSE].size_bytes))
    log = simulate(OFFERS, link([8e6]).trace, smallest, rules())
    assert log.policy == "smallest" and {s.rung for s in log.shown} == {WORSE}
    package = open_package(VALID / "two-groups-sh1")
    assert simulate(package, Trace.open("const:100"), "fixed:0", rules()).metrics.frames == package.manifest.frames


def test_without_its_key_a_group_is_lost_and_the_next_one_is_not():
    m = tiny_manifest()
    log = play(m, link([8e6]), "paper-no-cliff", faults=missing("key/T0/1.bin"))
    assert [s.rung is None for s in log.shown] == [True, False]
    assert log.metrics.lost_frames == 10 and log_rung(log, 1) == "Q0+L0"
    assert "frames 0-9" in log.lost[-1] and log.metrics.psnr_mean == 40.0
    assert log.shown[1].start_s == pytest.approx(log.shown[0].start_s + 1)  # the last picture stands for its time
    assert "lost" in format_metrics(log)
    nothing = play(m, link([8e6]), "paper-no-cliff", faults=missing(*m.group_files(0), *m.group_files(1)))
    assert all(s.rung is None for s in nothing.shown) and nothing.metrics.psnr_mean is None
    assert session_bound(nothing) is None


def log_rung(log, index):
    return log.offers.names[log.shown[index].rung]


rates = st.lists(st.sampled_from([0.0, 1e4, 5e4, 2e5, 5e6]), min_size=1, max_size=12).filter(any)
policies = st.sampled_from(
    ["paper", "paper-no-cliff", "paper-literal", "throughput", "bola", "robust-mpc", "oracle-frame", "fixed:1"]
)


@settings(max_examples=120)
@given(
    rates=rates,
    policy=policies,
    buffer_s=st.sampled_from([0.5, 2.0, 10.0]),
    extras=st.tuples(st.booleans(), st.booleans(), st.sampled_from([0.0, 0.5, 2.5])),
    split=st.booleans(),
    ahead=st.booleans(),
    bad=st.sampled_from([None, "state/L0/1.m4s", "key/T0/Q0/2.m4s", "key/T1/1.bin", "group/2.json.gz"]),
)
def test_any_session_is_causal_deterministic_and_accounted_for(rates, policy, buffer_s, extras, split, ahead, bad):
    m = segmented(tiny_manifest(groups=(30,))) if split else tiny_manifest()
    faults = missing(bad) if bad in list(m.files()) else {}
    again, give_up, wait = extras
    options = SessionSettings(buffer_s, wait, wait, 0.01, again, give_up, ahead, loops=3)
    over = link(rates, rtt=0.08)
    a, b = (simulate(Offers(m, root_bytes=1000), over, policy, options, faults) for _ in range(2))
    assert (a.fetches, a.shown, a.metrics) == (b.fetches, b.shown, b.metrics)
    for first, second in itertools.pairwise(a.fetches):
        assert first.request_s <= first.arrival_s <= second.request_s + over.rtt_s * ahead + 1e-9
        assert first.arrival_s <= second.arrival_s
    for s in a.shown:
        assert s.ready_s <= s.start_s + 1e-9
    ends = [s.start_s + s.frames / 10 for s in a.shown]
    for end, later in zip(ends, a.shown[1:], strict=False):
        assert later.stall_s >= 0 and later.start_s == pytest.approx(end + later.stall_s)
    quality = np.array([s.psnr for s in a.shown if s.psnr is not None])
    if len(quality):
        lost = np.abs(np.diff(quality)).sum() + STALL_DB * a.metrics.stall_s
        assert a.metrics.qoe == pytest.approx((quality.sum() - lost) / len(quality))
    assert sum(a.bytes_by_kind.values()) <= a.metrics.wire_bytes
    assert all(0 <= f.wasted <= f.bytes for f in a.fetches)
    used = over.bytes_between(0.0, a.fetches[-1].arrival_s)
    assert a.metrics.wire_bytes <= used * (1 + 1e-9) + len(a.fetches)  # nothing travels that the trace lacks
    bound = session_bound(a)
    if bound is not None:
        assert bound >= a.mean_quality - 1e-6


def segmented(m, count=3):
    """The one group of a tiny manifest in `count` segments."""
    part = m.frames // count
    levels = [replace(v, frame_bytes=v.frame_bytes[:part]) for v in m.segments[0].levels]
    return with_segments(m, [Segment(i * part, (i + 1) * part, levels) for i in range(count)])


def test_a_report_is_written(tmp_path):
    log = simulate(Offers(tiny_manifest(), 0, 1000), link([4e4, 0, 2e5], rtt=0.08), settings=SessionSettings(loops=5))
    page = write_report(log, tmp_path / "report")
    assert {p.name for p in page.parent.iterdir()} == {"index.html", "session.json"}
    assert page.read_text().count("<svg") == page.read_text().count("<figure") == 2
    assert json.loads((page.parent / "session.json").read_text())["answer"] == answer(log)
    assert all(words in html.unescape(page.read_text()) for words in answer(log).values())
    unmeasured = play(tiny_manifest(psnr=None), link([8e6]))
    assert "not measured" in write_report(unmeasured, tmp_path / "bare").read_text()


def test_a_report_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    log = play(tiny_manifest(), link([8e6]))
    with pytest.raises(ConfigError, match="cannot write"):
        write_report(log, tmp_path / "file")


def test_figures_of_a_session_are_what_its_batches_and_segments_say():
    """Two segments, of 5 and 10 frames, whose batches take 0.76 and 2.2156 s of a link that is never idle."""
    over = link([40_000, 8_000, 3_000, 90_000])
    log = play(tiny_manifest(), over, "throughput")
    fetches = [replace(f, fits=f.kind is BatchKind.TABLES) for f in log.fetches]
    fetches[2] = replace(fetches[2], retries=2, wasted=100)
    shown = [replace(log.shown[0], frames=5), replace(log.shown[1], rung=0, psnr=40.0)]
    m = session_metrics(log.offers, over, fetches, shown, {next(iter(FileKind)): 3000})
    assert (m.bytes_per_frame, m.wasted) == (200.0, 100 / sum(f.bytes for f in fetches))
    assert (m.retries, m.late, m.replaced, m.trace_ended) == (2, 0.5, 0, False)
    assert m.rungs == {"Q1+L0": 1, "Q0+L0": 1} and (m.switches, m.lost_frames, m.stalls) == (1, 0, 1)
    assert m.change_db == pytest.approx(4.0) and m.infeasible == 1.0
    assert m.qoe == pytest.approx((36 + 40 - 4 - STALL_DB * shown[1].stall_s) / 2)
    assert m.startup_requests == 1 + 1 + 5 + 2 and m.startup_bytes == 1000 + 100 + 3800
    took = fetches[4].arrival_s - fetches[4].request_s
    assert (m.frame_ms_p50, m.frame_ms_max) == pytest.approx((100 * took, 100 * took))
    assert m.frame_ms_mean == pytest.approx(1e3 * (0.76 + took) / 15)
    assert m.utilisation == pytest.approx(1.0) and (m.trace, m.trace_end, m.rtt_s) == ("t", "loop", 0.0)
    lost = [shown[0], replace(shown[1], rung=None, psnr=None, stall_s=SHORTEST_S)]
    m = session_metrics(log.offers, None, fetches, lost, {})
    assert m.rungs == {"Q1+L0": 1, "lost": 1} and (m.lost_frames, m.stalls, m.change_db) == (10, 0, 0.0)
    assert m.utilisation is m.trace_end is None
