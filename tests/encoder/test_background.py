"""The background of a scene: in sequence.json, in the package, behind every picture that is measured or shown."""

import json
from dataclasses import replace
from itertools import cycle, islice

import numpy as np
import pytest

from airgs_codec.encoder.survey import DRAWS
from airgs_codec.inspect.compare import claimed_quality
from tests.faces import (
    MEASURING,
    EncodeSettings,
    LevelSettings,
    Picture,
    SceneError,
    ViewPlan,
    before_background,
    compare_streams,
    draw_views,
    encode,
    open_package,
    open_sequence,
    psnr,
    render,
    rung_streams,
    write_ply,
)
from tests.support.multiview_files import write_cameras
from tests.support.views import coloured_cloud, ring

WHITE = (1.0, 1.0, 1.0)
SETTINGS = EncodeSettings(calibrate="none", measure_pictures=12, levels=(LevelSettings(0.0), LevelSettings(0.7, 4.0)))


def write_scene(folder, background=None):
    folder.mkdir()
    write_ply(folder / "0.ply", coloured_cloud(60))
    write_cameras(folder / "transforms.json", ring(4, size=64, held_out=1))
    if background is not None:
        (folder / "sequence.json").write_text(json.dumps({"fps": 25, "background": background}))
    return folder


@pytest.fixture(scope="module")
def packages(tmp_path_factory):
    """The same scene before white and before nothing: (folder of the scene, package) of each."""
    root = tmp_path_factory.mktemp("backgrounds")
    scenes = [write_scene(root / "white", WHITE), write_scene(root / "plain")]
    for scene in scenes:
        encode(open_sequence(scene), scene.with_suffix(".airgs"), SETTINGS)
    return [(scene, open_package(scene.with_suffix(".airgs"))) for scene in scenes]


def test_it_is_in_the_region_and_only_where_there_is_one(packages):
    (_, white), (plain_scene, plain) = packages
    assert white.manifest.region.background == [1, 1, 1]
    assert plain.manifest.region.background is None
    root = json.loads((plain_scene.with_suffix(".airgs") / "airgs.json").read_text())
    assert "background" not in root["region"]


def test_views_of_all_kinds_see_it(packages):
    (scene, white), (_, plain) = packages
    region = white.manifest.region
    views = [*draw_views(region, 2, MEASURING), *open_sequence(scene).cameras]
    views += before_background(region, ring(2))
    assert {view.background for view in views} == {WHITE}
    assert {view.background for view in draw_views(plain.manifest.region, 2, MEASURING)} == {(0, 0, 0)}
    empty = coloured_cloud(1)
    picture = render(empty, views[0])
    np.testing.assert_allclose(picture.rgb[picture.transmittance == 1], 1)


def test_it_is_behind_a_region_that_names_none_and_not_behind_one_that_does(packages):
    (scene, white), (_, plain) = packages
    sequence, black = open_sequence(scene), replace(white.manifest.region, background=[0.0, 0.0, 0.0])
    assert ViewPlan.of(sequence, 8, region=plain.manifest.region).region.background == [1, 1, 1]
    assert ViewPlan.of(sequence, 8, region=black).region.background == [0, 0, 0]


def test_claimed_psnr_is_that_before_the_background(packages):
    """From the very views that were measured with: the claim is what they show before its own background alone."""
    for (scene, package), other in zip(packages, ((0.0, 0.0, 0.0), WHITE), strict=True):
        m, frames = package.manifest, range(1)
        views = list(islice(cycle(draw_views(m.region, DRAWS, MEASURING)), m.views.measured))
        found = []
        for some in (views, [replace(view, background=other) for view in views]):
            looked_at = [(number, view) for number in frames for view in some]
            errors = compare_streams(rung_streams(package, frames), open_sequence(scene), looked_at, Picture.mse)
            found.append(psnr(np.mean(errors["Q0+L0"])))
        claim = claimed_quality(m, ["Q0+L0"])["Q0+L0"].psnr
        assert claim == pytest.approx(found[0], abs=0.006) and abs(claim - found[1]) > 0.05


@pytest.mark.parametrize(
    "background", [[1, 1], [1, 1, 2], "white", "111", [0, None, 0], [True, False, True], ["1", 0, 0], 1]
)
def test_what_is_no_background_is_refused_in_one_line(tmp_path, background):
    scene = write_scene(tmp_path / "scene", background)
    with pytest.raises(SceneError, match="expected a background of r, g, b from 0 to 1") as caught:
        open_sequence(scene)
    assert "\n" not in str(caught.value)
