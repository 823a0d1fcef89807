"""A viewer's walk: by all places in their order, smooth, inside the region, never through what he looks at."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.package.region import departures, keep_inside, place_view
from airgs_codec.package.tables import Place
from airgs_codec.package.viewpath import SPEED, TURNING, path_by_cameras, path_of_region
from tests.support.regions import arc, place, row
from tests.support.regions import region as region_of

FPS = 10.0


def walk_of(path, count):
    """The first `count` cameras of a path, FPS of them a second."""
    return path.cameras(np.arange(count) / FPS)


def walk_region(region, count):
    return walk_of(path_of_region(region), count)


def positions(walk):
    return np.array([camera.position for camera in walk])


def comes_by(walk, place):
    return np.linalg.norm(positions(walk) - np.array(place.position), axis=1).min() < 0.1


def outside(region, walk):
    return [d for d in departures(region, walk) if not d.inside]


@pytest.mark.parametrize("region", [arc(315, 8, 1.2), arc(180, 7, 0.8), row(6, 0.7)], ids=["ring", "arc", "row"])
def test_a_walk_is_smooth_and_stays_inside(region):
    walk = walk_region(region, 900)
    assert not outside(region, walk) and path_of_region(region).unreached == 0
    assert all(comes_by(walk, place) for place in region.places)
    line = positions(walk)
    away = np.linalg.norm(np.subtract(region.places[0].position, region.places[0].focus))
    steps = np.linalg.norm(np.diff(line, axis=0), axis=1)
    assert steps.max() <= 1.5 * SPEED * away / FPS + 1e-9  # a cubic is at most half as fast again as its mean
    assert np.linalg.norm(np.diff(line, 2, axis=0), axis=1).max() < 0.6 * steps.max()  # no sudden stops or turns
    axes = np.array([camera.world_to_camera[2, :3] for camera in walk])
    turned = np.degrees(np.arccos(np.clip((axes[1:] * axes[:-1]).sum(axis=1), -1, 1)))
    assert turned.max() <= 1.6 * TURNING / FPS


def test_a_ring_is_walked_round_and_an_arc_to_and_fro():
    """Nobody goes across what the rig looks at, whatever the order of its places."""
    for region in (arc(315, 8, 1.2), arc(180, 9, 0.7), arc(270, 12, 0.0)):
        shuffled = replace(
            region, places=[region.places[i] for i in np.random.default_rng(1).permutation(len(region.places))]
        )
        for some in (region, shuffled):
            assert np.linalg.norm(positions(walk_region(some, 900)), axis=1).min() > 2.6
    round_trip = positions(walk_region(arc(315, 8, 1.2), 240))
    assert np.ptp(np.unwrap(np.arctan2(round_trip[:, 2], round_trip[:, 0]))) > 2 * np.pi - 0.5
    angles = np.arctan2(*positions(walk_region(arc(180, 9, 0.7), 900)).T[[2, 0]])
    assert angles.min() > -0.2 and angles.max() < np.pi + 0.2


@pytest.mark.parametrize("seed", range(1, 4))
def test_no_leg_of_a_round_trip_crosses_another(seed):
    corners = np.random.default_rng(seed).uniform(-5, 5, (8, 2))
    region = region_of(*[Place([x, y, 0], [x, y, 9], [0, 1, 0], 3.0) for x, y in corners])
    cameras = [place_view(region, place) for place in region.places]
    stops = np.array([stop.position[:2] for stop in path_by_cameras(region, cameras).tour])
    legs = list(zip(stops, np.roll(stops, -1, axis=0), strict=True))

    def side(leg, point):
        (ax, ay), (bx, by) = leg[1] - leg[0], point - leg[0]
        return np.sign(ax * by - ay * bx)

    def cross(one, other):
        return side(one, other[0]) * side(one, other[1]) < 0 and side(other, one[0]) * side(other, one[1]) < 0

    assert len(legs) > 5 and not any(cross(one, other) for one, other in itertools.combinations(legs, 2))


def test_a_walk_bends_out_of_no_narrow_region():
    """Round corners would leave balls that only touch: there the walk is straight."""
    corners = [(0, 0), (2, 0), (2, 2), (4, 2), (4, 0)]
    region = region_of(*[Place([x, y, 0], [x, y, 9], [0, 1, 0], 1.001) for x, y in corners])
    walk = walk_region(region, 900)
    assert not outside(region, walk) and all(comes_by(walk, place) for place in region.places)
    assert outside(replace(region, places=[replace(p, reach=0.9) for p in region.places]), walk)


def test_one_place_and_places_within_its_reach_are_a_circle():
    for region in (row(1, 2.0), row(3, 2.0)):
        walk = walk_region(region, 200)
        middle = region.places[len(region.places) // 2]
        away = np.linalg.norm(positions(walk) - middle.position, axis=1)
        assert not outside(region, walk) and away.min() > 0.8 and away.max() < 1.2
        assert np.ptp(positions(walk), axis=0).max() > 1.8


def test_who_may_not_move_stands_still():
    region = replace(row(1, 0.0), turn=0.0)
    walk = walk_region(region, 5)
    assert len(walk) == 5 and not outside(region, walk) and np.ptp(positions(walk), axis=0).max() == 0


def test_opposite_places_have_no_way_between_them():
    region = arc(180, 2, 0.5)
    walk = walk_region(region, 300)
    assert path_of_region(region).unreached == 1 and not outside(region, walk)
    assert np.linalg.norm(positions(walk), axis=1).min() > 2.5


SHAPES = {
    "small": row(1, 0.01),
    "a point": row(1, 0.0),
    "one side": arc(60, 5, 0.45),
    "ring": arc(315, 8, 1.2),
    "ring that barely touches": arc(315, 8, 1.1499),
    "a gap that is hardly there": region_of(place(0.0, reach=0.9), place(2.0, reach=1.09), turn=30.0),
    "ring with a gap": arc(280, 8, 1.04),  # neighbours are 2.05 apart, the ends 3.9
    "ring of islands": arc(315, 8, 0.5),
    "islands": row(4, 0.3),
    "no room to turn": replace(row(4, 0.6), turn=0.5),
    "one looks elsewhere": region_of(*row(3, 0.8).places, Place([3, 0, 0], [13, 0, 0], [0, 1, 0], 0.8)),
}


@pytest.mark.parametrize("region", SHAPES.values(), ids=SHAPES)
def test_a_walk_never_leaves_the_region(region):
    assert not outside(region, path_of_region(region).cameras(np.arange(0, 100, 0.023)))


def test_a_gap_is_crossed_only_by_who_asks_for_it():
    """A ring with a gap is walked to and fro. Of parts that are apart, the walk keeps to the one with most sights."""
    angles = np.arctan2(*positions(walk_region(SHAPES["ring with a gap"], 900)).T[[2, 0]]) % (2 * np.pi)
    assert np.degrees(np.ptp(angles)) > 230 and not ((np.radians(300) < angles) & (angles < np.radians(340))).any()
    islands = [Place([float(x), 0, 0], [float(x), 0, 10], [0, 1, 0], 0.6) for x in (0, 5, 6, 7)]
    path = path_of_region(region_of(*islands))
    assert path.unreached == 1 and positions(walk_of(path, 300))[:, 0].min() > 4
    assert path_of_region(SHAPES["islands"]).unreached == 3
    crossing = outside(SHAPES["islands"], walk_of(path_of_region(SHAPES["islands"], kept=False), 300))
    assert crossing and max(d.distance for d in crossing) == pytest.approx(0.2, abs=0.02)


def test_a_viewer_is_moved_to_the_nearest_view_that_is_allowed():
    region = region_of(Place([0, 0, 0], [0, 0, 10], [0, 1, 0], 1.0), turn=30.0)
    inside, beyond, askew = [0.5, 0, 0], [3, 0, 0], [0, 0.5, 0]
    looked_at = np.array([[0, 0, 10], [3, 0, 9], [9, 0.5, 0.0]])
    places, foci = keep_inside(region, np.array([inside, beyond, askew]), looked_at)
    np.testing.assert_allclose(places, [inside, [1, 0, 0], askew], atol=1e-12)
    assert foci[0].tolist() == [0, 0, 10] and foci[1].tolist() == [1, 0, 9]
    ahead, to_focus = foci[2] - askew, np.array([0, -0.5, 10])
    cosine = ahead @ to_focus / np.linalg.norm(ahead) / np.linalg.norm(to_focus)
    assert np.degrees(np.arccos(cosine)) == pytest.approx(30) and np.linalg.norm(ahead) == pytest.approx(9)


def test_a_walk_by_cameras_uses_places_on_its_way_and_says_what_it_leaves():
    region = arc(180, 7, 0.9)
    ends = [replace(place_view(region, region.places[i]), width=64, fx=99.0) for i in (0, 6)]
    walk = walk_of(path_by_cameras(region, ends), 400)
    assert not outside(region, walk) and np.linalg.norm(positions(walk), axis=1).min() > 2.6
    assert all(comes_by(walk, place) for place in (region.places[0], region.places[3], region.places[6]))
    assert {(c.width, c.fx) for c in walk} == {(64, 99.0)}
    far = replace(region, places=region.places[:2])
    assert len(outside(far, walk)) > 100


@pytest.mark.parametrize("up", [[0, 0, 1], [1e-9, 0, 0], [1, 1, 1]], ids=str)
def test_a_place_whose_up_is_no_direction_across_its_view_still_has_pictures(up):
    for ahead in ([0, 0, 10], [10, 10, 10]):
        region = region_of(Place([0, 0, 0], ahead, up, 1.0))
        walk = walk_region(region, 20)
        assert all(np.isfinite(camera.world_to_camera).all() for camera in walk) and not outside(region, walk)


@pytest.mark.parametrize("region", [arc(180, 7, 0.8), row(1, 0.0)], ids=["arc", "one place"])
def test_a_path_has_a_view_at_any_time(region):
    """A walk is a path looked at again and again; in between it goes on."""
    path, walk = path_of_region(region), walk_region(region, 30)
    for i in (0, 7, 29):
        np.testing.assert_allclose(path.at(i / FPS).world_to_camera, walk[i].world_to_camera, atol=1e-12)
    before, between, after = (path.at(seconds).position for seconds in (0.7, 0.75, 0.8))
    assert np.linalg.norm(between - (before + after) / 2) <= 0.05 * np.linalg.norm(after - before) + 1e-12
