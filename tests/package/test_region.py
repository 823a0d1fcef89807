"""Views drawn from a region follow the law of FORMAT.md; and which way is up, from what people say."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests import faces
from tests.faces import ConfigError, FormatError, Place, World, draw_views, open_package, up_of, upright, world_from
from tests.support.manifests import tiny_manifest
from tests.support.paths import VALID
from tests.support.regions import is_inside, place, region, region_json

ROW = region(place(-3.0), place(0.0), place(3.0, reach=1.5))
BARE = faces.root_of(tiny_manifest())
QUARTERS = [0.25, 0.5, 0.75]


@given(st.integers(0, 2**32 - 1), st.floats(0, 100), st.floats(0, 180), st.sampled_from([0.0, 1e6]))
def test_draws_lie_inside(seed, reach, turn, shift):
    """Where a reach goes further than the focus, too."""
    at = place(1.0, reach=reach)
    far = Place([v + shift for v in at.position], [v + shift for v in at.focus], at.up, at.reach)
    r = region(far, turn=turn)
    for view in draw_views(r, 4, seed):
        assert np.isfinite(view.world_to_camera).all() and is_inside(r, view)


def test_places_take_turns_and_the_same_seed_draws_the_same_views_and_another_one_others():
    first, again, other = (draw_views(ROW, 12, seed) for seed in (5, 5, 1))
    for a, b in zip(first, again, strict=True):
        assert a.name == b.name and np.array_equal(a.world_to_camera, b.world_to_camera)
    assert not {v.position.tobytes() for v in first} & {v.position.tobytes() for v in other}
    for start in range(0, 12, 3):
        assert sorted(round(view.position[0] / 3) for view in first[start : start + 3]) == [-1, 0, 1]
    assert draw_views(ROW, 0, 5) == []


def test_distances_are_even_directions_even_over_the_sphere_and_axes_even_over_the_disk():
    at = place(0.0, reach=2.0)
    drawn = draw_views(region(at), 2000, 1)
    positions = np.stack([view.position for view in drawn])
    steps = positions - np.array(at.position)
    distance = np.linalg.norm(steps, axis=1, keepdims=True)
    assert np.quantile(distance / 2, QUARTERS) == pytest.approx(QUARTERS, abs=0.04)
    for heights in (steps / distance).T:  # Archimedes: the height of a point of the sphere is even
        assert np.quantile(heights, QUARTERS) == pytest.approx([-0.5, 0, 0.5], abs=0.06)
    ahead = np.array(at.focus) - positions
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    axes = np.stack([view.world_to_camera[2, :3] for view in drawn])
    off_focus = np.degrees(np.arccos(np.clip((ahead * axes).sum(axis=1), -1, 1)))
    assert np.quantile((off_focus / 10) ** 2, QUARTERS) == pytest.approx(QUARTERS, abs=0.04)


def test_without_extent_draws_are_the_places():
    points = region(place(-1.0, reach=0.0), place(2.0, reach=0.0), turn=0.0)
    for view in draw_views(points, 4, 3):
        same = faces.place_view(points, points.places[int(view.position[0] > 0)])
        np.testing.assert_allclose(view.world_to_camera, same.world_to_camera, atol=1e-12)
        assert (view.width, view.height, view.near) == (32, 24, 0.01)
        assert 2 * np.degrees(np.arctan(12 / view.fy)) == pytest.approx(50) and view.fx == view.fy


def changed(**values):
    """The text of a file with another place in the middle, or other values."""
    data = region_json(ROW)
    first, middle, last = data["places"]
    at = {name: values.pop(name) for name in middle.keys() & values}
    return json.dumps(data | {"places": [first, middle | at, last]} | values)


@pytest.mark.parametrize(("text", "reason", "detail"), [
    ("{", "not_json", "expected JSON"),
    ("[]", "wrong_type", "expected dict"),
    ("{}", "missing_field", "missing fields"),
    (changed(places=[]), "bad_value", "region.json.places: expected 1 to 64 values, got 0"),
    (changed(near=0), "bad_value", "region.json.near"),
    (changed(turn=181), "bad_value", "region.json.turn"),
    (changed(fov_y=float("nan")), "not_json", "NaN"),
    (changed(reach=-1), "bad_value", "places[1].reach"),
    (changed(position=[0, 0]), "bad_value", "places[1].position"),
    (changed(focus=[0, 0, -4]), "bad_value", "places[1].focus: expected other than [0.0, 0.0, -4.0]"),
    (changed(up=[0, 0, 0]), "bad_value", "places[1].up"),
])  # fmt: skip
def test_a_region_comes_back_from_a_file_as_given_and_what_is_none_is_refused_in_a_line(tmp_path, text, reason, detail):
    file = tmp_path / "region.json"
    for path in (file, tmp_path):
        with pytest.raises(faces.SceneError, match="cannot read a viewing region"):
            faces.read_region(path)
    file.write_text(changed())
    assert faces.read_region(file) == replace(ROW, source="file")
    file.write_text(text)
    with pytest.raises(FormatError) as caught:
        faces.read_region(file)
    assert caught.value.reason == reason and detail in str(caught.value) and "\n" not in str(caught.value)


def test_up_is_level_in_the_pictures_of_all_places_whichever_way_they_look_down():
    """As in regions that are found: what is up in a picture is at a right angle to its view."""
    up = np.array([0.0, -0.6, 0.8])
    sides = np.array([[1.0, 0.0, 0.0], [0.0, 0.8, 0.6]])
    places = []
    for i, pitch in enumerate(np.radians([70.0, 50.0, 24.0, 16.0, -20.0])):
        level = np.array([np.cos(2.4 * i), np.sin(2.4 * i)]) @ sides
        view, tip = level * np.cos(pitch) - up * np.sin(pitch), level * np.sin(pitch) + up * np.cos(pitch)
        places.append(Place((-3 * view).tolist(), [0.0, 0.0, 0.0], (2 * tip).tolist(), 0.5))
    assert upright(replace(ROW, source="found", places=places)) == pytest.approx(up, abs=1e-3)


@pytest.fixture
def package(tmp_path):
    return shutil.copytree(VALID / "moving", tmp_path / "moving.airgs")


@pytest.mark.parametrize(
    ("up", "direction", "moved"),
    [("y", [0, 1, 0], [2, 3, 5]), ("-y", [0, -1, 0], [2, -3, -5]), ("z", [0, 0, 1], [2, 5, -3]),
     ("-z", [0, 0, -1], [2, -5, 3]), ("x", [1, 0, 0], [-3, 2, 5])],
)  # fmt: skip
def test_axes_turn_as_people_know_them(package, up, direction, moved):
    assert faces.airgs_manifest(["set-view", str(package), f"--up={up}"]) == 0
    world = open_package(package).manifest.world
    assert (np.reshape(world.transform, (3, 4)) @ [2, 3, 5, 1]).tolist() == moved
    assert up_of(world).tolist() == direction and not world.metric


@given(
    up=st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 1e-3),
    metres=st.sampled_from([None, 1e-6, 0.01, 1.0, 250.0, 1e6]),
)
def test_any_direction_goes_up_in_a_right_handed_world(up, metres):
    world = world_from(up, metres)
    axes = np.reshape(world.transform, (3, 4))[:, :3] / (metres or 1)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(axes) > 0 and world.metric == (metres is not None)
    np.testing.assert_allclose(up_of(world), np.array(up) / np.linalg.norm(up), atol=1e-9)


@given(tilt=st.floats(-1e-7, 1e-7), sway=st.floats(-1e-7, 1e-7))
def test_directions_beside_minus_y_turn_alike(tilt, sway):
    turns = [world_from(up).transform for up in ((tilt, -1.0, sway), (0, -1, 0))]
    np.testing.assert_allclose(*turns, atol=1e-6, rtol=0)


def test_a_reader_takes_the_least_and_the_largest_scale_whatever_the_turn_and_others_are_refused():
    for up in np.random.default_rng(0).normal(size=(100, 3)).tolist():
        for metres in (1e-6, 1e6):
            told = replace(BARE, world=world_from(up, metres))
            assert faces.parse_root(faces.pack_json(told)) == told
    for metres in (0.0, -1.0, 1e9, float("nan")):
        with pytest.raises(ConfigError, match="scale"):
            world_from((0, 1, 0), metres)


def test_a_transform_is_read_from_text_and_json_of_three_or_four_rows(tmp_path):
    values = [0.4, -0.3, 0.0, 1.0, 0.3, 0.4, 0.0, 2.0, 0.0, 0.0, 0.5, 3.0]  # a turn about z, of half the size
    rows = np.reshape([*values, 0, 0, 0, 1], (4, 4)).tolist()
    file = tmp_path / "world"
    for text in ("\n".join(" ".join(map(repr, row)) for row in rows), *map(json.dumps, (rows, rows[:3], values))):
        file.write_text(text)
        assert faces.read_world(file) == World(values, metric=True)


@pytest.mark.parametrize(("text", "words"), [
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
    ("1 0.01 0 0  0 1 0 0  0 0 1 0", "rotation"),
    ("0 0 0 0  0 0 0 0  0 0 0 0", "scale of"),
    ("8e6 -6e6 0 0  6e6 8e6 0 0  0 0 1e7 0", "scale of 1e-06"),
])  # fmt: skip
def test_other_files_are_refused_in_a_line(tmp_path, text, words):
    file = tmp_path / "world.txt"
    with pytest.raises(ConfigError, match="cannot read"):
        faces.read_world(file)
    file.write_text(text)
    with pytest.raises(ConfigError, match=words) as refusal:
        faces.read_world(file)
    assert str(refusal.value).startswith(str(file)) and "\n" not in str(refusal.value)


def test_what_is_told_is_up_at_every_place_and_what_is_not_has_no_field():
    assert b"world" not in faces.pack_json(BARE)
    assert faces.levelled(BARE.region, None) is BARE.region
    told = faces.levelled(BARE.region, world_from((0, 0, 1)))
    assert all(place.up == [0, 0, 1] for place in told.places)
    assert upright(told).tolist() == [0, 0, 1]


@pytest.mark.parametrize(("up", "name", "line"), [
    ((0, 1, 0), "a.spz", None),
    ((0, -1, 0), "a.ply", None),
    ((0, -1, 0), "a.glb", "glTF take up: (0, 1, 0); units: one is 1 m; here it is up: (0, -1, 0); units: unknown"),
    (None, "a.spz", ".spz take up: (0, 1, 0); units: unknown; here it is up: unknown, players take that"),
])  # fmt: skip
def test_a_format_that_means_another_up_is_named(package, tmp_path, capsys, up, name, line):
    if up:
        faces.set_view(package, up=up)
    assert faces.airgs_decode([str(package), "-o", str(tmp_path / name), "--frames", "0:1"]) == 0
    out = capsys.readouterr().out
    assert f"\ncoordinates stay: readers of {line}" in out if line else "coordinates stay" not in out
