"""Sessions that can be followed with a pencil, and what must hold in any of them."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from airgs_codec.errors import ConfigError
from airgs_codec.parse import parse_manifest
from airgs_codec.play.link import Link
from airgs_codec.play.report import format_metrics, write_report
from airgs_codec.play.session import SessionSettings, metrics, screen_ticks, simulate
from airgs_codec.play.trace import Trace
from tests.manifests import tiny_manifest

BARE = {"decode_frame_s": 0.0, "loops": 1}


def link(rates, starts=None, duration=None, rtt=0.0, headers=0):
    starts = list(range(len(rates))) if starts is None else starts
    trace = Trace("t", np.array(starts, float), np.array(rates, float), float(duration or starts[-1] + 1))
    return Link(trace, rtt, headers)


def fixed(level, **options):
    return SessionSettings("fixed", level, **(BARE | options))


@pytest.mark.parametrize("options", [{}, {"psnr": None}, {"state_bytes": (2000, 1000, 0)}], ids=str)
def test_the_test_manifest_is_a_manifest(options):
    m = tiny_manifest(**options)
    assert parse_manifest(m.to_json()) == m


def test_a_session_by_hand():
    """10,000 B/s: 1000 B of manifests, then 150 init + 4000 key + 2000 state + 300 sidecars, and less init."""
    log = simulate(tiny_manifest(), 1000, link([8e4]), fixed(0))
    assert [(f.kind, f.bytes) for f in log.fetches] == [("manifests", 1000), ("group", 6450), ("group", 6300)]
    assert [f.arrival_s for f in log.fetches] == pytest.approx([0.1, 0.745, 1.375])
    assert [s.start_s for s in log.shown] == pytest.approx([0.745, 1.745])
    result = metrics(log)
    assert result["startup_s"] == pytest.approx(0.745)
    assert (result["stalls"], result["stall_s"], result["switches"], result["frames"]) == (0, 0, 0, 20)
    assert result["bytes"] == {"manifests": 1000, "init": 150, "key": 8000, "sidecars": 600, "state": 4000}
    assert result["wire_bytes"] == 13_750
    assert result["psnr_mean"] == 40.0
    assert result["trace_mean_bps"] == 8e4


def test_a_tier_is_fetched_when_a_level_first_needs_it():
    """The last level does with T0; rising in the middle of a group brings T1 along, once."""
    m = tiny_manifest(groups=(30,), psnr=None)
    thirds = [replace(m.segments[0], start=s, stop=s + 10) for s in (0, 10, 20)]
    for i, segment in enumerate(thirds):
        levels = [replace(v, number=i + 1, frame_bytes=v.frame_bytes[:10]) for v in segment.levels]
        thirds[i] = replace(segment, levels=levels)
    files = dict(m.files)
    for path, entry in m.files.items():
        if path.startswith("state/") and not path.endswith("init.mp4"):
            head, _, tail = path.rpartition("/1.")
            files |= {f"{head}/{n}.{tail}": entry for n in (2, 3)}
    m = replace(m, levels=[*m.levels[:2], replace(m.levels[2], tiers=1)], segments=thirds, files=files)
    assert parse_manifest(m.to_json()) == m
    low = simulate(m, 1000, link([8e4]), fixed(2))
    assert low.bytes_by_kind["key"] == 3000 and low.bytes_by_kind["sidecars"] == 100 + 3 * 100
    high = simulate(m, 1000, link([8e4]), fixed(0))
    assert high.bytes_by_kind["key"] == 4000 and high.bytes_by_kind["sidecars"] == 200 + 3 * 100


def test_half_the_rate_stalls_and_the_frozen_picture_counts():
    log = simulate(tiny_manifest(psnr=[[40.0, 0.0]] * 3), 1000, link([4e4]), fixed(0))
    assert [f.arrival_s for f in log.fetches] == pytest.approx([0.2, 1.49, 2.75])
    assert [s.stall_s for s in log.shown] == pytest.approx([0, 0.26])
    ticks = screen_ticks(log)
    assert len(ticks) == 23  # 20 frames, 0.26 s of waiting at 10 fps
    assert ticks[10:13] == [(0, 9)] * 3
    assert metrics(log)["stall_ratio"] == pytest.approx(0.26 / 2.26)


def test_headers_round_trips_and_decoding_cost_time():
    log = simulate(tiny_manifest(), 1000, link([8e4], rtt=0.1, headers=100), fixed(0, decode_frame_s=0.05))
    # manifests 1 file; 3 init, 2 tiers of 3 files, state of 2; then without init
    assert [f.arrival_s for f in log.fetches] == pytest.approx([0.21, 1.065, 1.875])
    assert log.shown[0].start_s == pytest.approx(1.115)


def test_an_outage_is_waited_out():
    log = simulate(tiny_manifest(), 1000, link([8e4, 0, 8e4], [0, 1, 6], 100), fixed(0))
    assert log.fetches[-1].arrival_s == pytest.approx(6.375)
    assert log.shown[1].stall_s == pytest.approx(6.375 - 1.745)


def test_a_level_with_nothing_to_fetch_costs_only_its_key():
    log = simulate(tiny_manifest(state_bytes=(2000, 1000, 0)), 1000, link([8e4]), fixed(2))
    assert [f.bytes for f in log.fetches[1:]] == [100 + 4000 + 200, 4200]
    assert metrics(log)["bytes"].get("state", 0) == 0


def test_the_buffer_holds_requests_back():
    log = simulate(tiny_manifest(), 1000, link([8e9]), fixed(0, loops=20, buffer_s=3.0))
    begin = log.shown[0].start_s
    for i, fetch in enumerate(log.fetches[1:]):
        assert fetch.request_s >= begin + i + 1 - 3.0 - 1e-9
    assert log.fetches[-1].request_s == pytest.approx(begin + 40 - 3.0)
    assert metrics(log)["stalls"] == 0


def test_loops_fetch_keys_and_states_again_but_not_init_segments():
    once, twice = (metrics(simulate(tiny_manifest(), 1000, link([8e6]), fixed(1, loops=n)))["bytes"] for n in (1, 2))
    assert twice == {k: v * (1 if k in ("init", "manifests") else 2) for k, v in once.items()}
    default = simulate(tiny_manifest(), 1000, link([8e6]), fixed(1, loops=None))
    assert metrics(default)["played_s"] == 30.0


def test_key_quality_and_level_are_chosen_together():
    rich = simulate(tiny_manifest(), 1000, link([8e7]), SessionSettings(**BARE))
    poor = simulate(tiny_manifest(), 1000, link([2e4]), SessionSettings(**BARE))
    assert {(s.quality, s.level, s.psnr) for s in rich.shown} == {(0, 0, 40.0)}
    assert {(s.quality, s.level, s.psnr) for s in poor.shown} == {(1, 2, 32.0)}
    assert "nothing fits" in poor.fetches[1].reason and "fit" in rich.fetches[1].reason


def test_a_faster_link_is_no_worse_however_fast():
    log = simulate(tiny_manifest(), 1000, link([8e18]), SessionSettings(**BARE))
    assert {(s.quality, s.level) for s in log.shown} == {(0, 0)}


def test_paper_needs_measured_quality_everywhere():
    m = tiny_manifest()
    levels = [replace(m.segments[1].levels[0], psnr=[]), *m.segments[1].levels[1:]]
    holes = replace(m, segments=[m.segments[0], replace(m.segments[1], levels=levels)])
    for unmeasured in (tiny_manifest(psnr=None), holes):
        with pytest.raises(ConfigError, match="no measured quality"):
            simulate(unmeasured, 1000, link([8e6]), SessionSettings(**BARE))
    log = simulate(tiny_manifest(psnr=None), 1000, link([8e6]), fixed(0))
    assert metrics(log)["psnr_mean"] is None and "not measured" in format_metrics(log)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"buffer_s": 0.0}, "buffer"),
        ({"buffer_s": float("nan")}, "buffer"),
        ({"decode_frame_s": -1.0}, "decoding"),
        ({"decode_frame_s": float("inf")}, "decoding"),
        ({"loops": 0}, "loops"),
        ({"loops": -1}, "loops"),
        ({"fixed_level": 3}, "level"),
    ],
)
def test_settings_that_cannot_work(options, words):
    with pytest.raises(ConfigError, match=words):
        simulate(tiny_manifest(), 1000, link([8e6]), replace(fixed(0), **options))


@pytest.mark.parametrize("rtt", [-0.1, float("nan"), float("inf")])
def test_round_trips_that_cannot_be(rtt):
    with pytest.raises(ConfigError, match="round trip"):
        simulate(tiny_manifest(), 1000, link([8e6], rtt=rtt), fixed(0))


rates = st.lists(st.sampled_from([0.0, 1e4, 5e4, 2e5, 5e6]), min_size=1, max_size=12).filter(any)


@settings(deadline=None, max_examples=60)
@given(rates=rates, policy=st.sampled_from(["paper", "fixed"]), buffer_s=st.sampled_from([0.5, 2.0, 10.0]))
def test_any_session_is_causal_deterministic_and_accounted_for(rates, policy, buffer_s):
    m = tiny_manifest()
    rules = SessionSettings(policy, 1, buffer_s, loops=5)
    a, b = (simulate(m, 1000, link(rates, rtt=0.08, headers=350), rules) for _ in range(2))
    assert (a.fetches, a.shown, metrics(a)) == (b.fetches, b.shown, metrics(b))
    for first, second in itertools.pairwise(a.fetches):
        assert first.request_s <= first.arrival_s <= second.request_s
    for s in a.shown:
        assert s.ready_s <= s.start_s
    ends = [s.start_s + s.frames / 10 for s in a.shown]
    for end, later in zip(ends, a.shown[1:], strict=False):
        assert later.stall_s >= 0 and later.start_s == pytest.approx(end + later.stall_s)
    payload = sum(a.bytes_by_kind.values())
    assert payload <= metrics(a)["wire_bytes"]
    used = a.link.trace.bits_until(a.fetches[-1].arrival_s)
    assert 8 * metrics(a)["wire_bytes"] <= used * (1 + 1e-9) + 1e-3  # nothing travels that the trace does not carry


def test_a_report_is_written(tmp_path):
    log = simulate(tiny_manifest(), 1000, link([4e4, 0, 2e5], rtt=0.08), SessionSettings(loops=5))
    page = write_report(log, tmp_path / "report")
    assert {p.name for p in page.parent.iterdir()} == {"index.html", "session.json", "session.png"}
    assert (page.parent / "session.png").read_bytes().startswith(b"\x89PNG")
    unmeasured = simulate(tiny_manifest(psnr=None), 1000, link([8e6]), fixed(0))
    assert "not measured" in write_report(unmeasured, tmp_path / "bare").read_text()


def test_a_report_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    log = simulate(tiny_manifest(), 1000, link([8e6]), fixed(0))
    with pytest.raises(ConfigError, match="cannot write"):
        write_report(log, tmp_path / "file")
