"""Which pictures decide and which measure: others, over all frames, from all of the region, before its background."""

import json
from dataclasses import replace
from itertools import cycle, islice

import numpy as np
import pytest

from tests import faces
from tests.faces import MEASURING, EncodeSettings, Picture, draw_views, open_package, open_sequence
from tests.support.multiview_files import write_cameras
from tests.support.packages import TWO_LEVELS
from tests.support.paths import FOX
from tests.support.regions import is_inside, place, region
from tests.support.scenes import moving_frames, random_gaussians, write_sequence
from tests.support.splat_files import glb_bytes
from tests.support.views import coloured_cloud, joined, ring

WHITE, BLACK = (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)


def views_of(sequence, **settings):
    return faces.choose_views(sequence, EncodeSettings(**settings))[0]


@pytest.fixture(scope="module")
def fox():
    sequence = open_sequence(FOX)
    return sequence, views_of(sequence)


def places(views):
    return {view.position.tobytes() for view in views}


def test_no_view_that_decides_measures(fox):
    sequence, plan = fox
    assert plan.trusted and plan.region.source == "cameras"
    measuring = plan.measuring(sequence)
    assert not places(plan.deciding) & places(measuring)
    for view in [*plan.deciding[:20], *measuring[:20]]:
        assert is_inside(plan.region, view)
    assert max(view.width * view.height for view in plan.deciding) <= 1.01 * 200_000
    assert {(v.width, v.height) for v in measuring} == {(plan.region.width, plan.region.height)}
    for a, b in zip(measuring, views_of(sequence).measuring(sequence), strict=True):
        assert np.array_equal(a.world_to_camera, b.world_to_camera)


def test_all_frames_of_a_group_decide_or_evenly_many_from_end_to_end_and_others_check(fox):
    """About the groups of a run more of them do, with the square root of their number."""
    sequence, plan = fox
    for frames in (1, 2, 5, 10, 23, 24, 240):
        pictures = plan.decide(range(7, 7 + frames))
        numbers = {frame for frame, _ in pictures}
        assert len(pictures) == plan.decided == len(places(view for _, view in pictures))
        assert (len(numbers), min(numbers), max(numbers)) == (min(frames, plan.decided), 7, 6 + frames)
    ranking, checking = plan.decide(range(24), 4), plan.check(range(24))
    assert len(ranking) == 2 * plan.decided
    assert len(checking) == 16 and len({frame for frame, _ in checking}) == 16
    assert not places(view for _, view in ranking) & places(view for _, view in checking)
    given = [replace(region(place(0.0)), width=width, height=300) for width in (300, 400)]  # more of small pictures
    assert [views_of(sequence, decide_pictures=10, region=one).decided for one in given] == [20, 10]


def test_without_a_margin_the_held_out_cameras_measure(fox):
    sequence, _ = fox
    plan, held_out = views_of(sequence, margin=0.0), [c for c in sequence.cameras if c.held_out]
    assert [c.name for c in plan.measuring(sequence)] == [c.name for c in held_out]
    assert not places(plan.deciding) & places(held_out)
    training = replace(sequence, cameras=[c for c in sequence.cameras if not c.held_out])
    alone = views_of(training, margin=0.0)
    assert len(places(alone.measuring(training))) == len(alone.region.places)  # no others: the places themselves


def test_a_region_that_is_given_is_taken_and_cameras_keep_their_own_up(fox):
    (sequence, plan), given = fox, region(place(0.0), source="file")
    taken = views_of(sequence, region=given)
    assert taken.region == given and taken.trusted
    assert all(is_inside(given, view) for view in taken.measuring(sequence))
    told = views_of(sequence, world=faces.world_from((1, 0, 0)))
    assert told.region == plan.region and plan.world is None


def test_up_is_guessed_without_cameras_and_a_world_is_of_the_coordinates_in_files_and_mirrors_nothing():
    plan, notes = faces.choose_views(faces.GaussianSequence.from_arrays(moving_frames(60, 3)), EncodeSettings())
    assert plan.region.source == "orbit" and not plan.trusted
    assert plan.world is None and notes[1].startswith("cannot tell up: showing (")
    with pytest.raises(faces.ConfigError, match="world: expected a right-handed turn, got one that mirrors"):
        EncodeSettings(world=faces.World([1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 0], metric=False))
    turned = np.array([[2, 0, 0, 1], [0, 0, 2, 1], [0, -2, 0, 1.0]])
    there = faces.GaussianSequence.from_arrays(moving_frames(60, 1)).at_origin((8, 4, 2))
    told = views_of(there, world=faces.World(turned.ravel().tolist(), metric=True)).world
    np.testing.assert_allclose(np.reshape(told.transform, (3, 4)) @ [1, 2, 3, 1], turned @ [9, 6, 5, 1])


def test_the_specification_of_a_format_tells_up_unless_somebody_does(tmp_path):
    (tmp_path / "a.glb").write_bytes(glb_bytes(random_gaussians(40)))
    sequence = open_sequence(tmp_path / "a.glb")
    plan, notes = faces.choose_views(sequence, EncodeSettings())
    told, others = faces.choose_views(sequence, EncodeSettings(world=faces.world_from((0, 0, -1))))
    assert plan.world == faces.world_from((0, 1, 0), 1.0)
    assert notes[-1] == "up: (0, 1, 0); units: one is 1 m; the specification of glTF says so"
    assert faces.up_of(told.world).tolist() == [0, 0, -1] and not any("specification" in note for note in others)
    assert all(at.up[2] <= 0 for at in told.region.places), "the views that were found are upright"
    assert notes[1].startswith("cannot tell up: showing (0, 1, 0), as .glb files should have it")


def test_a_floor_against_the_specification_leaves_the_way_up_to_the_views(tmp_path):
    x, z = np.random.default_rng(2).uniform(-1, 1, (2, 2000))
    lying = replace(random_gaussians(2000), means=np.stack([x, 0 * x, z], axis=1).astype(np.float32))
    flat = np.tile(np.log([0.05, 0.001, 0.05]), (2000, 1)).astype(np.float32)
    upright = np.tile(np.array([1, 0, 0, 0], np.float32), (2000, 1))
    lying = replace(lying, log_scales=flat, quaternions=upright, opacity_logits=np.full(2000, 4, np.float32))
    below = replace(coloured_cloud(200), means=(coloured_cloud(200).means / 8 - [0, 0.4, 0]).astype(np.float32))
    (tmp_path / "a.glb").write_bytes(glb_bytes(joined(lying, below)))
    plan, notes = faces.choose_views(open_sequence(tmp_path / "a.glb"), EncodeSettings())
    assert plan.world is None and all(at.up[1] < -0.7 for at in plan.region.places[:1])
    assert "though .glb files should have another" in notes[1] and not any("specification" in note for note in notes)


def write_scene(folder, background=None):
    more = {} if background is None else {"fps": 25, "background": background}
    write_sequence(folder, [coloured_cloud(60)], cameras=False, **more)
    write_cameras(folder / "transforms.json", ring(4, size=64, held_out=1))
    return folder


@pytest.fixture(scope="module")
def backgrounds(tmp_path_factory):
    """The same scene before white and before nothing: (sequence, package) of each."""
    root, found = tmp_path_factory.mktemp("backgrounds"), []
    settings = EncodeSettings(calibrate="none", measure_pictures=12, levels=TWO_LEVELS)
    for name, background in (("white", WHITE), ("plain", None)):
        sequence, out = open_sequence(write_scene(root / name, background)), root / f"{name}.airgs"
        faces.encode(sequence, out, settings)
        found.append((sequence, open_package(out)))
    return found


def test_a_background_is_in_the_region_where_there_is_one_and_behind_views_of_all_kinds(backgrounds):
    (sequence, white), (_, plain) = backgrounds
    given, none = white.manifest.region, plain.manifest.region
    assert (given.background, none.background) == ([1, 1, 1], None)
    assert "background" not in json.loads((plain.files.path / "airgs.json").read_text())["region"]
    views = [*draw_views(given, 2, MEASURING), *sequence.cameras, *faces.before_background(given, ring(2))]
    assert {view.background for view in views} == {WHITE}
    assert {view.background for view in draw_views(none, 2, MEASURING)} == {BLACK}
    picture = faces.render(coloured_cloud(1), views[0])
    np.testing.assert_allclose(picture.rgb[picture.transmittance == 1], 1)
    named = [none, replace(given, background=list(BLACK))]  # it is behind a region that names none alone
    assert [views_of(sequence, region=one).region.background for one in named] == [[1, 1, 1], [0, 0, 0]]


def test_claimed_psnr_is_that_before_the_background(backgrounds):
    """From the very views that were measured with: the claim is what they show before its own background alone."""
    for (sequence, package), other in zip(backgrounds, (BLACK, WHITE), strict=True):
        m, found = package.manifest, []
        views = list(islice(cycle(draw_views(m.region, 240, MEASURING)), m.views.measured))
        for some in (views, [replace(view, background=other) for view in views]):
            streams, looked_at = faces.rung_streams(package, range(1)), [(0, view) for view in some]
            errors = faces.compare_streams(streams, iter(sequence.load([0]).frames), looked_at, Picture.mse)
            found.append(faces.psnr(np.mean(errors["Q0+L0"])))
        claim = faces.quality_of(m, 0, 0).psnr
        assert claim == pytest.approx(found[0], abs=0.006) and abs(claim - found[1]) > 0.05


@pytest.mark.parametrize("background", [
    [1, 1], [1, 1, 2], "white", "111", [0, None, 0], [True, False, True], ["1", 0, 0], 1,
], ids=str)  # fmt: skip
def test_what_is_no_background_is_refused_in_one_line(tmp_path, background):
    with pytest.raises(faces.SceneError, match="expected a background of r, g, b from 0 to 1") as caught:
        open_sequence(write_scene(tmp_path / "scene", background))
    assert "\n" not in str(caught.value)
