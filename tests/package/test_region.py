"""Views drawn from a region lie inside, follow the law that FORMAT.md gives, and come from the seed alone."""

import copy
import json
from dataclasses import asdict, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airgs_codec.errors import FormatError, SceneError
from airgs_codec.package.parse import read_region
from airgs_codec.package.region import departure, draw_views, first_place, place_view, upright
from airgs_codec.package.tables import Place
from tests.support.regions import place, region

ROW = region(place(-3.0), place(0.0), place(3.0, reach=1.5))
AS_JSON = {name: value for name, value in asdict(ROW).items() if value is not None}
UP = np.array([0.0, -1.0, 0.0])


def offsets(drawn, at):
    """(n, 3) from a place to the views."""
    return np.stack([view.position for view in drawn]) - np.array(at.position)


def off_focus(drawn, at):
    """(n,) degrees between view axes and the direction to the focus."""
    ahead = np.array(at.focus) - np.stack([view.position for view in drawn])
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    axes = np.stack([view.world_to_camera[2, :3] for view in drawn])
    return np.degrees(np.arccos(np.clip((ahead * axes).sum(axis=1), -1, 1)))


@given(
    seed=st.integers(0, 2**32 - 1),
    reach=st.floats(0, 100),  # further than the focus, too
    turn=st.floats(0, 180),
    shift=st.sampled_from([0.0, 1e6]),
)
def test_draws_lie_inside(seed, reach, turn, shift):
    at = place(1.0, reach=reach)
    far = Place([v + shift for v in at.position], [v + shift for v in at.focus], at.up, at.reach)
    r = region(far, turn=turn)
    for view in draw_views(r, 4, seed):
        assert np.isfinite(view.world_to_camera).all()
        assert departure(r, view).inside


def test_the_same_seed_draws_the_same_views_and_another_one_others():
    first, again, other = (draw_views(ROW, 6, seed) for seed in (0, 0, 1))
    for a, b in zip(first, again, strict=True):
        assert a.name == b.name and np.array_equal(a.world_to_camera, b.world_to_camera)
    assert not {v.position.tobytes() for v in first} & {v.position.tobytes() for v in other}


def test_places_take_turns():
    for start in range(0, 12, 3):
        three = draw_views(ROW, 12, 5)[start : start + 3]
        assert sorted(round(view.position[0] / 3) for view in three) == [-1, 0, 1]


def test_distances_are_even_directions_even_over_the_sphere_and_axes_even_over_the_disk():
    drawn, at = draw_views(region(place(0.0, reach=2.0)), 2000, 1), place(0.0, reach=2.0)
    steps = offsets(drawn, at)
    distance = np.linalg.norm(steps, axis=1) / 2
    assert np.quantile(distance, [0.25, 0.5, 0.75]) == pytest.approx([0.25, 0.5, 0.75], abs=0.04)
    heights = steps / np.linalg.norm(steps, axis=1, keepdims=True)
    for axis in range(3):  # Archimedes: the height of a point of the sphere is even
        assert np.quantile(heights[:, axis], [0.25, 0.5, 0.75]) == pytest.approx([-0.5, 0, 0.5], abs=0.06)
    area = (off_focus(drawn, at) / 10) ** 2
    assert np.quantile(area, [0.25, 0.5, 0.75]) == pytest.approx([0.25, 0.5, 0.75], abs=0.04)


def test_without_extent_draws_are_the_places():
    points = region(place(-1.0, reach=0.0), place(2.0, reach=0.0), turn=0.0)
    places = {1: place_view(points, points.places[1]), 0: place_view(points, points.places[0])}
    for view in draw_views(points, 4, 3):
        same = places[int(view.position[0] > 0)]
        np.testing.assert_allclose(view.world_to_camera, same.world_to_camera, atol=1e-12)
        assert (view.width, view.height, view.near) == (32, 24, 0.01)
        assert 2 * np.degrees(np.arctan(12 / view.fy)) == pytest.approx(50) and view.fx == view.fy


def written(tmp_path, text):
    path = tmp_path / "region.json"
    path.write_text(text)
    return path


def test_a_region_comes_back_from_a_file_as_given(tmp_path):
    assert read_region(written(tmp_path, json.dumps(AS_JSON))) == replace(ROW, source="file")


def changed(name, value, of=None):
    data = copy.deepcopy(AS_JSON)
    (data["places"][1] if of else data)[name] = value
    return json.dumps(data)


@pytest.mark.parametrize(
    ("text", "reason", "detail"),
    [
        ("{", "not_json", "expected JSON"),
        ("[]", "wrong_type", "expected dict"),
        ("{}", "missing_field", "missing fields"),
        (changed("places", []), "bad_value", "region.json.places: expected 1 to 64 values, got 0"),
        (changed("near", 0), "bad_value", "region.json.near"),
        (changed("turn", 181), "bad_value", "region.json.turn"),
        (changed("fov_y", float("nan")), "not_json", "NaN"),
        (changed("reach", -1, "place"), "bad_value", "places[1].reach"),
        (changed("position", [0, 0], "place"), "bad_value", "places[1].position"),
        (changed("focus", [0, 0, -4], "place"), "bad_value", "places[1].focus: expected other than [0.0, 0.0, -4.0]"),
        (changed("up", [0, 0, 0], "place"), "bad_value", "places[1].up"),
    ],
)
def test_a_file_that_is_no_region_is_one_line(tmp_path, text, reason, detail):
    with pytest.raises(FormatError) as caught:
        read_region(written(tmp_path, text))
    assert caught.value.reason == reason and detail in str(caught.value) and "\n" not in str(caught.value)


def test_a_region_that_cannot_be_read_is_one_line(tmp_path):
    for path in (tmp_path / "none.json", tmp_path):
        with pytest.raises(SceneError, match="cannot read a viewing region"):
            read_region(path)


def test_where_nobody_chose_the_places_a_viewer_begins_where_a_scene_is_looked_down_at_slightly():
    above, _, slightly, _ = places = [
        Place([x, y, 0.0], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0], 0.0) for x, y in [(0.1, 5), (5, -1), (5, 1.5), (5, 4)]
    ]
    assert first_place(replace(ROW, source="found", places=places)) is slightly
    assert first_place(replace(ROW, source="cameras", places=places)) is above


def test_up_is_level_in_the_pictures_of_all_places_whichever_way_they_look_down():
    """As in regions that are found: what is up in a picture is at a right angle to its view."""
    up = np.array([0.0, -0.6, 0.8])
    sides = np.array([[1.0, 0.0, 0.0], [0.0, 0.8, 0.6]])
    places = []
    for i, pitch in enumerate(np.radians([70.0, 50.0, 24.0, 16.0, -20.0])):
        level = np.array([np.cos(2.4 * i), np.sin(2.4 * i)]) @ sides
        view, tip = level * np.cos(pitch) - up * np.sin(pitch), level * np.sin(pitch) + up * np.cos(pitch)
        places.append(Place((-3 * view).tolist(), [0.0, 0.0, 0.0], (2 * tip).tolist(), 0.5))
    region = replace(ROW, source="found", places=places)
    assert upright(region) == pytest.approx(up, abs=1e-3)
    assert first_place(region) is places[2]
