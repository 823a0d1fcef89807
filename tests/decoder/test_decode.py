"""The public way in: one frame of a package, level and key quality by id or by index."""

import numpy as np
import pytest

from airgs_codec.decoder.decode import decode, decode_canonical, decode_frames, decode_segment
from airgs_codec.errors import ConfigError
from airgs_codec.package.package import open_package
from tests.support.paths import VALID


@pytest.fixture(scope="module")
def package():
    return open_package(str(VALID / "moving"))


def same(a, b):
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in a.__slots__)


@pytest.mark.parametrize("level", ["L1", 1, "1"])
def test_a_frame_is_that_of_the_sequence_however_its_rung_is_named(package, level):
    frames = [f.gaussians for f in decode_frames(package, 0, 4, level=1, key_quality=1)]
    assert same(decode(package, 2, level=level, key_quality="Q1"), frames[2])
    assert not same(decode(package, 2), frames[2])


@pytest.mark.parametrize("places", [[], [0], [3], [1, 3], [0, 2, 3], range(1, 3)])
@pytest.mark.parametrize("level", [0, 1])
def test_some_frames_of_a_segment_are_those_of_the_whole(package, level, places):
    base = decode_canonical(package, 0, 0)
    whole = list(decode_segment(package, 0, base, level, range(4)))
    some = list(decode_segment(package, 0, base, level, places))
    assert len(some) == len(places) and all(same(whole[i], g) for i, g in zip(places, some, strict=True))


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ({"level": "L9"}, "level: expected one of L0, L1, got 'L9'"),
        ({"level": -1}, "level: expected one of L0, L1, got -1"),
        ({"level": "Q0"}, "level: expected one of L0, L1, got 'Q0'"),
        ({"key_quality": 2}, "key_quality: expected one of Q0, Q1, got 2"),
        ({"frame": 4}, "frame: expected 0..3, got 4"),
        ({"frame": -1}, "frame: expected 0..3, got -1"),
    ],
)
def test_what_the_package_does_not_have_is_refused_in_one_line(package, choice, message):
    with pytest.raises(ConfigError) as refused:
        decode(package, **({"frame": 0} | choice))
    assert str(refused.value) == message


@pytest.mark.parametrize("frames", [(0, 5), (-1, 2), (3, 2)], ids=str)
def test_frames_that_the_package_does_not_have_are_refused_in_one_line(package, frames):
    with pytest.raises(ConfigError, match=f"^frames: expected a range inside 0:4, got {frames[0]}:{frames[1]}$"):
        next(decode_frames(package, *frames))
