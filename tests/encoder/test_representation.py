"""Representations: what is published decodes to what every decoder and screen leaves alone."""

from fractions import Fraction
from functools import partial

import numpy as np
import pytest

from airgs_codec.coding.atlas import picture_size
from airgs_codec.coding.escapes import LIMIT
from airgs_codec.encoder import representation
from airgs_codec.encoder.representation import Clock, encode_checked
from airgs_codec.media.h264 import (
    ClosedGop,
    check_gop,
    encode_gop,
    in_range,
    state_codec,
)
from tests.faces import EncodeSettings, encode, measure_errors, open_package, open_sequence, validate
from tests.support.scenes import moving_frames, write_sequence

SIZE = (128, 128)
CODEC = state_codec("veryfast")


def noise(reach, kind, count=6):
    """`count` pictures whose samples differ from 128 by at most `reach`."""
    rng = np.random.default_rng(reach)
    shape = (count, 128, 128)
    signed = {"ends": rng.choice([-1.0, 1.0], shape), "even": rng.uniform(-1, 1, shape)}[kind]
    return np.rint(128 + reach * signed).astype(np.uint8)


@pytest.mark.parametrize("kind", ["ends", "even"])
def test_the_limit_of_escapes_leaves_room_for_the_error_of_the_codec(kind):
    closed = ClosedGop(noise(LIMIT, kind), 0, 1)
    assert check_gop(encode_gop(closed, SIZE, Fraction(24), CODEC), closed, CODEC).in_range


def test_pictures_that_would_leave_the_range_are_coded_finer():
    """They alone: the segments beside them keep their bytes."""
    bright, calm = (ClosedGop(noise(reach, "ends"), 0, 1) for reach in (106, 60))
    coarse = [encode_gop(gop, SIZE, Fraction(24), CODEC) for gop in (bright, calm)]
    assert not check_gop(coarse[0], bright, CODEC).in_range
    coded = encode_checked([bright, calm], SIZE, Clock.of(Fraction(24)), CODEC).gops
    shown = list(coded[0].pictures("x"))
    assert len(shown) == 6 and all(in_range(picture) for picture in shown)
    assert len(coded[0].fragment) > len(coarse[0].fragment) and coded[1].fragment == coarse[1].fragment


def test_an_atlas_that_is_too_large_for_a_picture_is_decoded_from_pages(tmp_path, monkeypatch):
    """Every key and level is, here, and every value keeps to its `max_error`."""
    monkeypatch.setattr(representation, "picture_size", partial(picture_size, macroblocks=16))
    sequence = open_sequence(write_sequence(tmp_path / "scene", moving_frames(600, 5), cameras=False))
    settings = EncodeSettings(calibrate="none", measure_pictures=0, preset="veryfast", threads=2, segment_s=0.1)
    encode(sequence, tmp_path / "out", settings)
    assert validate(tmp_path / "out") == []
    package = open_package(tmp_path / "out")
    assert all(found.error <= found.bound for found in measure_errors(package, sequence))
    m = package.manifest
    atlases = [*m.groups[0].tiers[0].qualities, m.groups[0].levels[0]]
    assert all(atlas.pages > 1 and atlas.height == 64 for atlas in atlases)
    assert len(m.segments) > 1
