"""A slow link: the bucket by a clock of its own, and the relay in front of a server."""

import time

import numpy as np
import pytest

from airgs_codec.play.trace import Trace
from tests.support.paths import VALID
from tests.support.servers import say, serving
from tools.lab.relay import LATE_S, Bucket, shaped

PACKAGE = VALID / "two-groups-sh1"
REQUEST = b"GET /two-groups-sh1/airgs.json HTTP/1.1\r\nHost: a\r\n"
CLOSE = b"Connection: close\r\n\r\n"


class Clock:
    def __init__(self):
        self.now_s = 1000.0

    def __call__(self):
        return self.now_s


def test_bytes_pass_one_after_another_at_the_rate_of_the_moment():
    clock = Clock()
    trace = Trace("t", np.array([0.0, 1.0, 2.0]), np.array([8e3, 0.0, 16e3]), 3.0)  # 1 kB/s, nothing, 2 kB/s
    bucket = Bucket(trace, clock)
    assert bucket.take(500) == pytest.approx(0.5)
    assert bucket.take(500) == pytest.approx(1.0)  # of another connection
    assert bucket.take(1000) == pytest.approx(2.5)  # behind the outage
    clock.now_s += 2.5
    assert bucket.take(1000) == pytest.approx(0.5)


def test_what_comes_late_is_made_up_for_and_idle_time_is_not():
    clock = Clock()
    bucket = Bucket(Trace.open("const:0.008"), clock)  # 1 kB/s
    bucket.take(100)
    clock.now_s += 0.1 + 0.02
    assert bucket.take(100) == pytest.approx(0.1 - 0.02)
    clock.now_s += 0.5
    assert bucket.take(100, idle=True) == pytest.approx(0.1)
    clock.now_s += 100.0  # of a client that took nothing
    assert bucket.take(1000) == pytest.approx(1.0 - LATE_S)


def test_the_trace_begins_with_the_first_request():
    clock = Clock()
    bucket = Bucket(Trace("t", np.array([0.0, 1.0]), np.array([8e3, 16e3]), 10.0), clock)
    clock.now_s += 50.0
    bucket.begin()
    clock.now_s += 2.0
    bucket.begin()
    assert bucket.take(1000, idle=True) == pytest.approx(0.5)


def test_answers_come_a_round_trip_late_and_no_faster_than_the_link():
    size = len(say_plainly(REQUEST + CLOSE))
    trace = Trace.open(f"const:{8e-6 * size / 0.1:g}")  # an answer in 0.1 s
    with serving(PACKAGE) as server, shaped(server, trace, 0.05) as port:
        began_s = time.monotonic()
        answer = say(port, 2 * (REQUEST + b"\r\n") + REQUEST + CLOSE)  # share a round trip
        took_s = time.monotonic() - began_s
    assert len(answer) > 2.9 * size and answer.count(b"HTTP/1.1 200") == 3
    assert took_s >= 0.05 + 2.9 * 0.1


def say_plainly(data):
    with serving(PACKAGE) as port:
        return say(port, data)
