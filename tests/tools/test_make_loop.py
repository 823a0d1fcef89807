"""Loops, and the packages that people see first."""

from dataclasses import replace

import numpy as np
import pytest

from tests.faces import decode, find_faults, open_package, open_sequence, place_view
from tests.support.paths import CORPUS
from tests.support.scenes import moving_frames, write_sequence
from tools.make_loop import main, mix

SHOWCASE = CORPUS / "showcase"


def test_the_end_of_a_loop_turns_into_what_was_before_its_beginning(tmp_path, capsys):
    frames = moving_frames(50, 12)
    words = [str(write_sequence(tmp_path / "long", frames)), "-o", str(tmp_path / "loop"), "--frames", "4:10"]
    words += ["--position", "0,0.5,3", "--focus", "0,0,0"]
    assert main(words) == 2 and not (tmp_path / "loop").exists()
    assert "--frames: expected A:B from 12 to 12, got 4:10" in capsys.readouterr().err
    assert main([*words, "--blend", "3"]) == 0
    loop = open_sequence(tmp_path / "loop")
    assert len(loop) == 6 and {camera.split for camera in loop.cameras} == {"train", "test"}
    for place in range(3):
        np.testing.assert_array_equal(loop.read(place).means, frames[4 + place].means)
    for place, share in ((3, 0.25), (4, 0.5), (5, 0.75)):
        expected = frames[4 + place].means * (1 - share) + frames[place - 2].means * share
        np.testing.assert_allclose(loop.read(place).means, expected, atol=1e-5)
    a, b = frames[:2]
    mixed, other = (mix(a, replace(b, quaternions=sign * b.quaternions), 0.5).quaternions for sign in (1, -1))
    np.testing.assert_allclose(np.linalg.norm(mixed, axis=1), 1, atol=1e-5)
    np.testing.assert_allclose(other, mixed, atol=1e-6)  # the shorter way


@pytest.mark.parametrize("name", ["head.airgs", "fox.airgs"])
def test_the_showcase_is_whole_small_and_says_whose_it_is(name):
    package = open_package(SHOWCASE / name)
    m = package.manifest
    assert find_faults(package) == {} and m.poster and m.attribution
    assert m.media_bytes() + package.manifest_bytes <= 1_500_000


def test_the_end_of_the_head_meets_its_beginning():
    package = open_package(SHOWCASE / "head.airgs")
    m = package.manifest
    assert m.frames / m.fps >= 8
    frames = {number: decode(package, number).means for number in (0, 1, m.frames - 2, m.frames - 1)}
    steps = [np.abs(frames[a] - frames[b]).mean() for a, b in ((0, 1), (m.frames - 2, m.frames - 1), (m.frames - 1, 0))]
    assert steps[2] < 2 * max(steps[:2])
    first = place_view(m.region, m.region.places[0])
    assert abs(first.position[0]) < 0.2, "from in front, 0.9 away"
