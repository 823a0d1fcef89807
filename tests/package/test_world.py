"""Which way is up and how long a unit is, from what people say, and what is refused."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airgs_codec.errors import ConfigError
from airgs_codec.package.package import open_package, root_of
from airgs_codec.package.parse import pack_json, parse_root
from airgs_codec.package.region import first_place, levelled, upright
from airgs_codec.package.tables import World
from airgs_codec.package.world import fault_of, misread, parse_up, read_world, unit_of, up_of, world_from, world_words
from airgs_codec.scene.formats.form import Axes
from tests.support.manifests import tiny_manifest
from tests.support.paths import VALID

TURN = [0.8, -0.6, 0.0, 0.6, 0.8, 0.0, 0.0, 0.0, 1.0]


def transform(axes, shift=(0.0, 0.0, 0.0)):
    """12 numbers, row by row."""
    return np.hstack([np.reshape(axes, (3, 3)), np.reshape(shift, (3, 1))]).ravel().tolist()


@pytest.mark.parametrize(
    ("up", "moved"), [("y", [2, 3, 5]), ("-y", [2, -3, -5]), ("z", [2, 5, -3]), ("-z", [2, -5, 3]), ("x", [-3, 2, 5])]
)
def test_axes_turn_as_people_know_them(up, moved):
    world = world_from(parse_up(up))
    assert (np.reshape(world.transform, (3, 4)) @ [2, 3, 5, 1]).tolist() == moved
    assert up_of(world).tolist() == list(parse_up(up)) and not world.metric


@given(
    up=st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 1e-3),
    metres=st.sampled_from([None, 1e-6, 0.01, 1.0, 250.0, 1e6]),
)
def test_any_direction_goes_up_in_a_right_handed_world(up, metres):
    world = world_from(up, metres)
    assert fault_of(world.transform) is None
    np.testing.assert_allclose(up_of(world), np.array(up) / np.linalg.norm(up), atol=1e-9)
    assert unit_of(world) == (None if metres is None else pytest.approx(metres))


@given(tilt=st.floats(-1e-7, 1e-7), sway=st.floats(-1e-7, 1e-7))
def test_directions_beside_minus_y_turn_alike(tilt, sway):
    np.testing.assert_allclose(
        world_from((tilt, -1.0, sway)).transform, world_from((0, -1, 0)).transform, atol=1e-6, rtol=0
    )


def test_the_least_and_the_largest_scale_may_stand_whatever_the_turn():
    for up in np.random.default_rng(0).normal(size=(100, 3)).tolist():
        assert [fault_of(world_from(up, metres).transform) for metres in (1e-6, 1e6)] == [None, None]


def test_what_is_no_similarity_is_refused_and_rounding_is_forgiven():
    assert fault_of(transform(TURN, (1e6, 0, 3))) is None
    assert fault_of((np.array(transform(TURN)) * 0.25).astype(np.float32).tolist()) is None
    faults = {
        "one scale": transform(np.array(TURN) * [1, 1, 1, 1, 1, 1, 1.001, 1.001, 1.001]),
        "rotation": transform([1, 0.01, 0, 0, 1, 0, 0, 0, 1]),
        "mirrors": transform([1, 0, 0, 0, 1, 0, 0, 0, -1]),
        "scale of": transform(np.zeros(9)),
        "scale of 1e-06": transform(np.array(TURN) * 1e7),
        "at most 1e.30, got 1e.31": transform(TURN, (1e31, 0, 0)),
        "got nan": transform(TURN, (float("nan"), 0, 0)),
        "got 3": [1, 2, 3],
    }
    for words, values in faults.items():
        assert re.search(words, fault_of(values))


def test_a_transform_is_read_from_text_and_json_of_three_or_four_rows(tmp_path):
    values = transform(np.array(TURN) * 0.5, (1, 2, 3))
    rows = np.reshape([*values, 0, 0, 0, 1], (4, 4))
    file = tmp_path / "world"
    for text in (
        "\n".join(" ".join(map(repr, row)) for row in rows.tolist()),
        json.dumps(rows.tolist()),
        json.dumps(rows[:3].tolist()),
        json.dumps(values),
    ):
        file.write_text(text)
        assert read_world(file) == World(values, metric=True)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1 2 3", "got 3 numbers"),
        ("1 0 0 0  0 1 0 0  0 0 1 x", "12 or 16 numbers"),
        ("[[1, 0], [0]]", "12 or 16 numbers"),
        ('{"transform": 1}', "12 or 16 numbers"),
        ("1 0 0 0  0 1 0 0  0 0 1 nan", "finite numbers of at most 1e.30, got nan"),
        ("1 0 0 1e35  0 1 0 0  0 0 1 0", "finite numbers of at most 1e.30, got 1e.35"),
        ("1e200 0 0 0  0 1e200 0 0  0 0 1e200 0", "at most 1e.30, got 1e.200"),
        (f"[1{'0' * 400}, 0, 0, 0]", "12 or 16 numbers, row by row: int too large"),
        ("1 0 0 0  0 1 0 0  0 0 1 0  0 0 1 1", "last row"),
        ("1 0 0 0  0 2 0 0  0 0 1 0", "one scale"),
        ("1 0 0 0  0 -1 0 0  0 0 1 0", "mirrors"),
    ],
)
def test_other_files_are_refused_in_a_line(tmp_path, text, words):
    file = tmp_path / "world.txt"
    file.write_text(text)
    with pytest.raises(ConfigError, match=words) as refusal:
        read_world(file)
    assert str(refusal.value).startswith(str(file)) and "\n" not in str(refusal.value)
    with pytest.raises(ConfigError, match="cannot read"):
        read_world(tmp_path / "nothing")


@pytest.mark.parametrize("text", ["up", "1,2", "0,0,0", "nan,0,1", "1,inf,0", ""])
def test_what_is_no_direction_is_refused(text):
    with pytest.raises(ConfigError, match="up"):
        world_from(parse_up(text))


@pytest.mark.parametrize("metres", [0.0, -1.0, 1e9, float("nan")])
def test_what_is_no_length_is_refused(metres):
    with pytest.raises(ConfigError, match="scale"):
        world_from((0, 1, 0), metres)


def test_a_package_without_it_has_no_such_field_and_one_with_it_comes_back():
    bare = root_of(tiny_manifest())
    assert b"world" not in pack_json(bare)
    told = replace(bare, world=world_from((0.1, 0.2, -3.0), 0.3))
    assert parse_root(pack_json(told)) == told and parse_root(pack_json(bare)) == bare


def test_what_is_told_is_up_at_every_place():
    m = tiny_manifest()
    assert levelled(m) is m.region
    told = levelled(replace(m, world=world_from((0, 0, 1))))
    assert all(place.up == [0, 0, 1] for place in told.places)
    assert upright(told).tolist() == [0, 0, 1]
    assert first_place(told).position == m.region.places[0].position


def test_the_package_of_the_corpus_says_it_in_words():
    m = open_package(VALID / "placed").manifest
    assert world_words(m.world) == "up: (0, 0, 1); units: one is 0.01 m"
    assert "not told" in world_words(None) and "units: not told" in world_words(world_from((0, 1, 0)))


def test_a_format_that_means_another_up_is_named():
    up, down = world_from((0, 1, 0)), world_from((0, -1, 0))
    assert misread(up, ".spz", Axes((0, 1, 0))) == [] == misread(down, "INRIA .ply", None)
    (line,) = misread(down, "glTF", Axes((0, 1, 0), 1.0))
    assert line == (
        "coordinates stay: readers of glTF take up: (0, 1, 0); units: one is 1 m; "
        "here it is up: (0, -1, 0); units: not told"
    )
    assert "not told" in misread(None, ".spz", Axes((0, 1, 0)))[0]
