"""Which way is up, where nobody tells it: animals stand on their feet, what rests is below, rooms have light above."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from airgs_codec.analysis.up import AXES, Subject, find_floor, find_front, guess_up
from airgs_codec.analysis.viewpoints import find_viewpoints
from airgs_codec.scene.camera import MARGIN
from airgs_codec.scene.gaussians import multiply
from tests.support.places import ball, discs, filmed_room, floor
from tests.support.views import joined

UP = np.array([0.0, 1.0, 0.0])


def tube(centre, half, count):
    """The surface of an ellipsoid with half axes (3,)."""
    normals = np.random.default_rng(count).normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return discs(np.array(centre) + np.array(half) * normals, normals, 0.05)


def animal():
    """A body on four legs, with a head whose colours vary; it looks along z, and y is up."""
    legs = [tube((x, 0.3, z), (0.06, 0.3, 0.06), 200) for x in (-0.2, 0.2) for z in (-0.4, 0.4)]
    head = tube((0, 1.05, 0.7), (0.15, 0.15, 0.2), 400)
    speckled = replace(head, sh_dc=8 * head.sh_dc)
    plain = [replace(part, sh_dc=0 * part.sh_dc) for part in (tube((0, 0.75, 0), (0.25, 0.2, 0.6), 1200), *legs)]
    return joined(joined(*plain[:2]), joined(joined(*plain[2:4]), joined(plain[4], speckled)))


def turned(g, turn):
    quaternion = np.roll(turn.as_quat(), 1)
    turns = np.tile(quaternion, (len(g), 1))
    return replace(
        g,
        means=(g.means @ turn.as_matrix().T).astype(np.float32),
        quaternions=multiply(turns, g.quaternions.astype(np.float64)).astype(np.float32),
    )


@pytest.mark.parametrize("turn", list(Rotation.create_group("O"))[::5], ids=lambda turn: str(turn.as_quat().round(1)))
def test_an_animal_stands_on_its_feet_and_is_seen_from_in_front_however_it_is_turned(turn):
    subject = Subject.of([turned(animal(), turn)])
    up = guess_up(subject)
    assert up == pytest.approx(turn.apply(UP), abs=1e-6)
    assert find_front(subject, up) @ turn.apply([0, 0, 1]) > 0.9


@pytest.mark.parametrize("lost", [0, 7], ids=["as many rows", "fewer rows"])
@pytest.mark.parametrize("ordered", [True, False], ids=["in order", "shuffled"])
def test_what_rests_is_below_what_moves(ordered, lost):
    still = ball()
    swayed = replace(still, means=still.means + np.maximum(still.means[:, :1] + 0.2, 0) * [0, 0.1, 0.2])
    swayed = replace(swayed, means=swayed.means.astype(np.float32))
    rows = np.arange(len(swayed)) if ordered else np.random.default_rng(1).permutation(len(swayed))
    swayed = swayed.take(rows[: len(rows) - lost])
    assert guess_up(Subject.of([still, swayed])) == pytest.approx([1, 0, 0])


def test_a_floor_has_everything_on_one_side():
    up = find_floor(joined(ball(), floor(-0.55)))
    assert up is not None and up @ [0, 1, 0] > 0.99
    assert find_floor(ball()) is None
    assert find_floor(joined(ball(), floor(0.0))) is None, "as much below as above"


@pytest.mark.parametrize("up", AXES[[1, 4]])
def test_a_place_that_was_filmed_is_lighter_above(up):
    room = filmed_room()
    light = np.where((room.means @ up)[:, None] > 0, 1.0, -1.0).astype(np.float32) * np.ones_like(room.sh_dc)
    assert guess_up(Subject.of([replace(room, sh_dc=light)]), filmed=True) == pytest.approx(up)


def test_the_first_view_shows_the_whole_subject_with_a_margin():
    g = animal()
    camera = find_viewpoints([g], UP).cameras[0]
    matrix = camera.world_to_camera
    x, y, z = matrix[:3, :3] @ g.means.T + matrix[:3, 3:]
    off = np.maximum(np.abs(x), np.abs(y)) / z * camera.fx * 2 / camera.width
    assert (z > 0).all() and np.mean(off < 1) > 0.98 and 0.8 / MARGIN < np.quantile(off, 0.98) < 1.01 / MARGIN
    assert matrix[1] @ [*UP, 0] < -0.9


def test_the_first_view_shows_what_few_large_rows_make_of_the_subject():
    normals = np.tile([0.0, 0, 1], (60, 1))
    centres = np.linspace([-3.0, 0, 0], [3.0, 0, 0], 60)
    wide = joined(animal(), discs(centres, normals, 0.5))
    camera = find_viewpoints([wide], UP).cameras[0]
    x, y, z = camera.world_to_camera[:3, :3] @ centres.T + camera.world_to_camera[:3, 3:]
    assert (z > 0).all() and (np.maximum(np.abs(x), np.abs(y)) / z * camera.fx * 2 / camera.width < 1).all()
