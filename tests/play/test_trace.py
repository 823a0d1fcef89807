"""Traces with answers that can be worked out by hand, and files nobody would like to read."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airgs_codec.play.trace import read_trace
from tests.faces import Link, Trace, TransportError
from tests.support.paths import FOX

RACA = (
    "Timestamp,State,DL_bitrate\n"
    "2017.12.04_15.24.12,D,3000\n"
    "2017.12.04_15.24.12,D,1000\n"
    "2017.12.04_15.24.13,D,-\n"
    "2017.12.04_15.24.15,D,8000\n"
)


def trace(rates, starts=None, duration=None):
    starts = list(range(len(rates))) if starts is None else starts
    return Trace("t", np.array(starts, float), np.array(rates, float), float(duration or starts[-1] + 1))


def written(tmp_path: Path, content: str | bytes) -> Path:
    path = tmp_path / "t.csv"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def test_a_download_waits_out_an_outage():
    outage = trace([8e6, 0, 8e6], [0, 1, 5], 10)
    assert outage.arrival_s(1_000_000, 0.0) == 1.0
    assert outage.arrival_s(2_000_000, 0.0) == 6.0
    assert outage.arrival_s(1, 3.0) == pytest.approx(5.000001)


def test_the_trace_begins_again():
    assert trace([8e6, 0]).arrival_s(3_000_000, 0.0) == 5.0
    assert trace([0, 8e6]).arrival_s(1_000_000, 0.0) == 2.0  # its end, not the start of the next outage
    assert trace([8e6, 0]).bits_until(3.0) == 16e6


def test_nothing_to_send_arrives_at_once():
    assert trace([8e6, 0]).arrival_s(0, 0.25) == 0.25


@given(
    rates=st.lists(st.sampled_from([0.0, 1e3, 1e6, 3e7]), min_size=1, max_size=8).filter(any),
    size=st.integers(1, 10_000_000),
    at=st.floats(0, 50),
)
def test_arrival_is_the_first_moment_with_enough_bits(rates, size, at):
    t = trace(rates)
    arrival = t.arrival_s(size, at)
    assert arrival >= at
    slack = 1e-6 * max(1.0, t.bits_until(arrival))
    assert t.bits_until(arrival) - t.bits_until(at) == pytest.approx(8 * size, rel=1e-6, abs=slack)
    assert t.arrival_s(size + 1000, at) >= arrival


@given(offset=st.floats(0, 2.99), size=st.integers(1, 2_000_000))
def test_a_cut_trace_is_the_same_trace_later(offset, size):
    t = trace([1e6, 0, 3e6])
    cut = t.cut(offset)
    assert cut.duration_s == t.duration_s and cut.mean_bps == pytest.approx(t.mean_bps)
    assert cut.arrival_s(size, 0.0) == pytest.approx(t.arrival_s(size, offset) - offset, abs=1e-6)


def test_scaling_multiplies_rates():
    assert trace([1e6, 0]).cut(scale=8).arrival_s(1_000_000, 0.0) == 1.0


@pytest.mark.parametrize(("offset", "scale"), [(-1, 1), (2, 1), (np.nan, 1), (0, 0), (0, -1), (0, np.inf), (0, np.nan)])
def test_cuts_that_cannot_be(offset, scale):
    with pytest.raises(TransportError, match="expected"):
        trace([1e6, 1e6]).cut(offset, scale)


def test_raca_averages_repeats_and_holds_through_skipped_and_missing_seconds(tmp_path):
    t = read_trace(written(tmp_path, RACA))
    assert t.starts_s.tolist() == [0, 3]
    assert t.rates_bps.tolist() == [2e6, 8e6]
    assert t.duration_s == 4


def test_the_embedded_trace_is_read():
    t = read_trace(FOX / "trace.csv")
    assert t.duration_s > 300 and 1e6 < t.mean_bps < 50e6


@pytest.mark.parametrize(
    "text", ["time_s,mbps\n10,2\n12,4\n", "10,2\n12,4", "10 2\r\n12 4\r\n", "\ufefft,r\n10, 2\n12, 4\n\n"]
)
def test_plain_csv(tmp_path, text):
    t = read_trace(written(tmp_path, text))
    assert (t.starts_s.tolist(), t.rates_bps.tolist(), t.duration_s) == ([0, 2], [2e6, 4e6], 4)


def test_mahimahi_counts_packets_in_each_millisecond(tmp_path):
    t = read_trace(written(tmp_path, "0\n2\n2\n5\n"))
    assert t.duration_s == 0.005
    assert t.bits_until(0.005) == pytest.approx(4 * 1500 * 8)
    assert t.bits_until(0.002) == pytest.approx(3 * 1500 * 8)  # those at 0 and at 2 ms
    assert t.bits_until(0.004) == pytest.approx(3 * 1500 * 8)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("\n\n", "empty"),
        (b"\xff\xfe\x00garbage", "cannot read"),
        ("hello\nworld\n", "expected Raca CSV"),
        ("[1, 2]", "expected Raca CSV"),
        ('[{"duration_ms": 500}]', "bandwidth_kbps"),
        ("[]", "expected Raca CSV"),
        ("[{", "expected Raca CSV"),
        ("time_s,mbps\n", "no rows"),
        ("time_s,mbps\n0,1\n1\n", "no rate in '1'"),
        ("0,1\n1,fast\n", "expected Raca CSV"),
        ("0,1\n0,2\n", "ascend"),
        ("0,-1\n1,2\n", "0 or more"),
        ("0,nan\n1,2\n", "finite"),
        ("nan,1\n1,2\n", "ascend"),
        ("0,0\n1,0\n", "zero all the time"),
        ("5\n3\n", "ascend"),
        ("99999999999999999\n", "more than a day"),
        ("Timestamp,DL_bitrate\n", "no DL_bitrate"),
        ("Timestamp,DL_bitrate\n2017.12.04_15.24.12,-\n", "no DL_bitrate"),
        ("Timestamp,DL_bitrate\nyesterday,5\n", "expected Raca CSV"),
        ("DL_bitrate\n5\n", "Timestamp"),
        ("Timestamp,DL_bitrate\n" + "5" * 200_000, "field larger"),
        ('[{"bandwidth_kbps": 1, "duration_ms": 1' + "0" * 400 + "}]", "too large"),
        ("[" * 100_000, "recursion"),
    ],
)
def test_bad_files_get_one_line(tmp_path, content, words):
    with pytest.raises(TransportError, match=words) as error:
        read_trace(written(tmp_path, content))
    assert "\n" not in str(error.value)


def test_missing_files_and_folders(tmp_path):
    for path in (tmp_path / "none.csv", tmp_path):
        with pytest.raises(TransportError, match="cannot read"):
            read_trace(path)


def test_a_batch_pays_one_round_trip():
    link = Link(trace([8e6]), rtt_s=0.1)
    assert link.arrival_s(3700, 1.0) == pytest.approx(1.1037)
    assert link.bytes_between(1.0, 1.5) == pytest.approx(500_000)
    assert link.bytes_between(1.5, 1.0) == 0


def test_what_follows_the_end():
    t = trace([8e6, 4e6])
    assert t.arrival_s(2_000_000, 0.0) == pytest.approx(2.5)  # 1 MB and 0.5 MB, then 0.5 MB again at the first rate
    assert t.ending("hold").arrival_s(2_000_000, 0.0) == pytest.approx(3.0)
    assert t.ending("hold").bits_until(3.0) == pytest.approx(16e6)
    assert (t.rate_at(2.5), t.ending("hold").rate_at(2.5), t.ending("error").rate_at(2.5)) == (8e6, 4e6, 0.0)
    assert t.ending("error").arrival_s(1_500_000, 0.0) == pytest.approx(2.0)
    with pytest.raises(TransportError, match="with 500000 bytes still to come"):
        t.ending("error").arrival_s(2_000_000, 0.0)
    with pytest.raises(TransportError, match="ends after 2 s"):  # a rate of zero for ever is an error, not a hang
        trace([8e6, 0]).ending("hold").arrival_s(2_000_000, 0.0)
    with pytest.raises(TransportError, match="expected an end"):
        t.ending("begin")


def test_sabre_periods_and_their_latency(tmp_path):
    t = read_trace(
        written(
            tmp_path,
            '[{"duration_ms": 500, "bandwidth_kbps": 2000, "latency_ms": 20},\n'
            ' {"duration_ms": 1500, "bandwidth_kbps": 4000, "latency_ms": 40}]',
        )
    )
    assert (t.starts_s.tolist(), t.rates_bps.tolist(), t.duration_s) == ([0, 0.5], [2e6, 4e6], 2.0)
    assert t.rtt_s == pytest.approx(0.03)
    assert t.cut(0.7).rtt_s == t.rtt_s


def test_constant_and_synthetic_traces():
    assert Trace.open("const:5").arrival_s(625_000, 0.0) == pytest.approx(1.0)
    a, b, c = Trace.open("markov:1"), Trace.open("markov:1"), Trace.open("markov:2:3")
    assert a.rates_bps.tolist() == b.rates_bps.tolist() and a.starts_s.tolist() == b.starts_s.tolist()
    assert a.mean_bps == pytest.approx(8e6) and c.mean_bps == pytest.approx(3e6)
    assert (a.rates_bps == 0).any() and a.duration_s == 300
    for bad in ("const:", "const:x", "const:1:2", "markov:x", "markov:1:2:3", "const:0", "const:-1", "const:nan"):
        with pytest.raises(TransportError):
            Trace.open(bad)
