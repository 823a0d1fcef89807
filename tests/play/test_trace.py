"""Traces with answers that can be worked out by hand, and files nobody would like to read."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.faces import Trace, TransportError
from tests.support.manifests import link
from tests.support.paths import FOX

DAY_S = 86_400


def trace(*rates, starts=(), duration=0, end="loop"):
    return link(rates, starts, duration, end=end).trace


def read(folder, content):
    path = folder / "t.csv"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return Trace.open(path)


OUTAGE = trace(8e6, 0, 8e6, starts=[0, 1, 5], duration=10)
FALLING = trace(8e6, 4e6)
rates = st.lists(st.sampled_from([0.0, 1e3, 1e6, 3e7]), min_size=1, max_size=8).filter(any)
RACA = "Timestamp,State,DL_bitrate\n" + "".join(
    f"2017.12.04_15.24.{row}\n" for row in ("12,D,3000", "12,D,1000", "13,D,-", "15,D,8000")
)
PLAIN = (
    "time_s,mbps\n10,2\n12,4\n",
    "10,2\n12,4",
    "10 2\r\n12 4\r\n",
    "\ufefft,rate\n10, 2\n12, 4\n\n",
    ("id;Time (ms);UL_kbps;Throughput [kbit/s]\n1;500;7;2000\n1;2500;7;4000\n"),
    "2026-03-29T01:59:59Z,2\n2026-03-29T02:00:01Z,4",
    "date,BPS,rate\n2026-03-29 01:59:59,2e6,1\n2026-03-29 02:00:01,4e6,1",
    ("timestamp\tMB/s\n7\t0.25\n9\t0.5"),
    "time,bytes_per_second\n7,250000\n9,500000",
)
SABRE = """[{"duration_ms": 500, "bandwidth_kbps": 2000, "latency_ms": 20},
 {"duration_ms": 1500, "bandwidth_kbps": 4000, "latency_ms": 40}]"""


@pytest.mark.parametrize(("what", "size", "at", "arrival"), [
    (OUTAGE, 1_000_000, 0.0, 1.0), (OUTAGE, 2_000_000, 0.0, 6.0), (OUTAGE, 1, 3.0, pytest.approx(5.000001)),
    (trace(8e6, 0), 3_000_000, 0.0, 5.0),  # it begins again
    (trace(0, 8e6), 1_000_000, 0.0, 2.0),  # its end, not the start of the next outage
    (trace(8e6, 0), 0, 0.25, 0.25),  # nothing to send arrives at once
    (trace(1e6, 0).cut(scale=8), 1_000_000, 0.0, 1.0),
    (FALLING, 2_000_000, 0.0, 2.5),  # 1 MB and 0.5 MB, then 0.5 MB again at the first rate
    (replace(FALLING, end="hold"), 2_000_000, 0.0, 3.0), (replace(FALLING, end="error"), 1_500_000, 0.0, 2.0),
    (link([8.0]), DAY_S - 1, 0.0, DAY_S - 1),
])  # fmt: skip
def test_when_a_download_arrives(what, size, at, arrival):
    assert what.arrival_s(size, at) == arrival


@pytest.mark.parametrize(("what", "size", "words"), [
    (replace(FALLING, end="error"), 2_000_000, "with 500000 bytes still to come"),
    (link([8.0]), DAY_S + 1, "expected at most"),
    (trace(8e6, 0, end="hold"), 2_000_000, "ends after 2 s"),  # a rate of zero for ever is an error, not a hang
])  # fmt: skip
def test_what_never_arrives(what, size, words):
    with pytest.raises(TransportError, match=words):
        what.arrival_s(size, 0.0)


@pytest.mark.parametrize("rate", [1e-12, 1e-13, 3e-15, 7e-17])
def test_an_arrival_after_countless_rounds_is_not_an_error(rate):
    """A trace of a thousand seconds that is repeated until the rounding of its rounds exceeds it."""
    slow = trace(rate, duration=1000)
    assert slow.arrival_s(1e3, 0.0) == pytest.approx(8e3 / rate) or rate < 1e-15
    assert slow.arrival_s(1e3, 0.0) <= math.inf


def test_what_can_pass_and_how_fast():
    over = link([8e6], rtt=0.1)
    assert (over.bytes_between(1.0, 1.5), over.bytes_between(1.5, 1.0)) == (pytest.approx(500_000), 0)
    assert trace(8e6, 0).bits_until(3.0) == 16e6 == pytest.approx(replace(FALLING, end="hold").bits_until(3.0))
    assert [replace(FALLING, end=end).rate_at(2.5) for end in ("loop", "hold", "error")] == [8e6, 4e6, 0.0]


@given(rates=rates, size=st.integers(1, 10_000_000), at=st.floats(0, 50))
def test_arrival_is_the_first_moment_with_enough_bits(rates, size, at):
    t = trace(*rates)
    arrival = t.arrival_s(size, at)
    assert arrival >= at
    slack = 1e-6 * max(1.0, t.bits_until(arrival))
    assert t.bits_until(arrival) - t.bits_until(at) == pytest.approx(8 * size, rel=1e-6, abs=slack)
    assert t.arrival_s(size + 1000, at) >= arrival


@given(offset=st.floats(0, 2.99), size=st.integers(1, 2_000_000))
def test_a_cut_trace_is_the_same_trace_later(offset, size):
    t = trace(1e6, 0, 3e6)
    cut = t.cut(offset)
    assert cut.duration_s == t.duration_s and cut.mean_bps == pytest.approx(t.mean_bps)
    assert cut.arrival_s(size, 0.0) == pytest.approx(t.arrival_s(size, offset) - offset, abs=1e-6)


@pytest.mark.parametrize(("offset", "scale"), [(-1, 1), (2, 1), (np.nan, 1), (0, 0), (0, -1), (0, np.inf), (0, np.nan)])
def test_cuts_that_cannot_be(offset, scale):
    with pytest.raises(TransportError, match="expected"):
        trace(1e6, 1e6).cut(offset, scale)


@pytest.mark.parametrize(("text", "starts", "rates", "duration", "rtt"), [
    (RACA, [0, 3], [2e6, 8e6], 6, None),  # repeats are averaged, skipped and missing seconds keep the rate
    *((text, [0, 2], [2e6, 4e6], 4, None) for text in PLAIN),
    (SABRE, [0, 0.5], [2e6, 4e6], 2, pytest.approx(0.03)),
])  # fmt: skip
def test_files_of_traces(tmp_path, text, starts, rates, duration, rtt):
    t = read(tmp_path, text)
    assert (t.starts_s.tolist(), t.rates_bps.tolist(), t.duration_s, t.rtt_s) == (starts, rates, duration, rtt)
    assert t.cut(0.7).rtt_s == t.rtt_s


def test_mahimahi_counts_packets_in_each_millisecond(tmp_path):
    """Three at 0 and at 2 ms."""
    t = read(tmp_path, "0\n2\n2\n5\n")
    assert t.duration_s == 0.005
    assert [t.bits_until(at) / 12_000 for at in (0.002, 0.004, 0.005)] == pytest.approx([3, 3, 4])


@pytest.mark.parametrize(("content", "words"), [
    ("\n\n", "empty"), (b"\xff\xfe\x00garbage", "cannot read"),
    *((text, "expected rows of times") for text in ("hello\nworld\n", "[1, 2]", "[]", "[{", "0,1\n1,fast\n")),
    ("Timestamp,DL_bitrate\nyesterday,5\n", "yesterday"), ("DL_bitrate\n5\n", "no columns such as time_s"),
    *((f"Timestamp,DL_bitrate\n{row}", "no readings") for row in ("", "2017.12.04_15.24.12,-\n")),
    ("Timestamp,DL_bitrate\n" + "5" * 200_000, "field larger"), ("[" * 100_000, "recursion"),
    ('[{"duration_ms": 500}]', "bandwidth_kbps"),
    ('[{"bandwidth_kbps": 1, "duration_ms": 1' + "0" * 400 + "}]", "too large"),
    ("time_s,mbps\n", "no readings"), ("time_s,mbps\n0,1\n1\n", "no rate in '1'"),
    *((text, "less than 1 Gbit/s of a phone, got 3: name its unit") for text in ("0,40\n1,3000\n", "time,mbps\n0,3e3")),
    *((text, "ascend") for text in ("1,1\n0,2\n", "0,1\nnan,2\n", "5\n3\n")),
    ("0,-1\n1,2\n", "0 or more"), ("0,nan\n1,2\n", "finite"), ("0,0\n1,0\n", "zero all the time"),
    ("99999999999999999\n", "more than a day"),
])  # fmt: skip
def test_bad_files_get_one_line(tmp_path, content, words):
    with pytest.raises(TransportError, match=words) as error:
        read(tmp_path, content)
    assert "\n" not in str(error.value)


def test_what_trace_names_open(tmp_path):
    assert Trace.open("const:5").arrival_s(625_000, 0.0) == pytest.approx(1.0)
    a, b, c = Trace.open("markov:1"), Trace.open("markov:1"), Trace.open("markov:2:3")
    assert a.rates_bps.tolist() == b.rates_bps.tolist() and a.starts_s.tolist() == b.starts_s.tolist()
    assert a.mean_bps == pytest.approx(8e6) and c.mean_bps == pytest.approx(3e6)
    assert (a.rates_bps == 0).any() and a.duration_s == 300
    embedded = Trace.open(FOX / "trace.csv")
    assert embedded.duration_s > 300 and 1e6 < embedded.mean_bps < 50e6
    for bad in ("const:", "const:x", "const:1:2", "markov:x", "markov:1:2:3", "const:0", "const:-1", "const:nan"):
        with pytest.raises(TransportError):
            Trace.open(bad)
    for path in (tmp_path / "none.csv", tmp_path):
        with pytest.raises(TransportError, match="cannot read"):
            Trace.open(path)
    with pytest.raises(TransportError, match="expected an end"):
        replace(a, end="begin")
