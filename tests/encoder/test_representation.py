"""Representations: what is published decodes to what every decoder and screen leaves alone."""

from fractions import Fraction

import numpy as np
import pytest

from airgs_codec.coding.escapes import LIMIT
from airgs_codec.encoder.representation import Clock, encode_checked
from airgs_codec.media.h264 import (
    ClosedGop,
    check_stream,
    decode_pictures,
    encode_stream,
    in_range,
    open_segment,
    state_codec,
)

CODEC = state_codec("veryfast")


def noise(reach, kind, count=6):
    """`count` pictures whose samples differ from 128 by at most `reach`."""
    rng = np.random.default_rng(reach)
    shape = (count, 128, 128)
    signed = {"ends": rng.choice([-1.0, 1.0], shape), "even": rng.uniform(-1, 1, shape)}[kind]
    return np.rint(128 + reach * signed).astype(np.uint8)


@pytest.mark.parametrize("kind", ["ends", "even"])
def test_the_limit_of_escapes_leaves_room_for_the_error_of_the_codec(kind):
    closed = [ClosedGop(noise(LIMIT, kind), 0, 1)]
    stream = encode_stream(closed, (128, 128), Fraction(24), 24, CODEC)
    assert check_stream(stream, closed, CODEC)[0].in_range


def test_pictures_that_would_leave_the_range_are_coded_finer():
    closed = [ClosedGop(noise(106, "ends"), 0, 1)]
    coarse = encode_stream(closed, (128, 128), Fraction(24), 24, CODEC)
    assert not check_stream(coarse, closed, CODEC)[0].in_range
    coded = encode_checked(lambda: closed, (128, 128), Clock.of(Fraction(24)), CODEC)
    shown = list(decode_pictures(open_segment(coded.stream.media[0], "x").samples, "x"))
    assert len(shown) == 6 and all(in_range(picture) for picture in shown)
