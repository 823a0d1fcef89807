"""The keyframe benchmark: its options mean what they say, and a frame without a history has no velocity."""

from dataclasses import replace

import pytest

from airgs_codec.errors import ConfigError
from airgs_codec.trainer import train
from airgs_codec.trainer.data.readers import open_scene
from tests.support.training import SETTINGS, write_blobs
from tools.lab.bench import keyframe
from tools.lab.command import Lab


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return write_blobs(tmp_path_factory.mktemp("scene") / "blobs")


@pytest.fixture(scope="module")
def model(scene, tmp_path_factory):
    settings = replace(SETTINGS, budget=150, first_iterations=10, frame_iterations=2, min_psnr_db=1.0, max_drop_db=99.0)
    return train(open_scene(scene, frames=(0, 3)), tmp_path_factory.mktemp("models") / "m", settings)


def test_pictures_are_shrunk_as_asked(scene, model):
    case = keyframe.open_case(scene, model.folder, 1, max_size=24)
    assert {view.camera.width for view in [*case.target.views, *case.held_out]} == {24}
    assert {v.camera.width for v in keyframe.open_case(scene, model.folder, 1, None).target.views} == {40}


def test_the_second_frame_of_a_group_has_no_velocity(scene, model):
    case = keyframe.open_case(scene, model.folder, 1, None)
    assert case.before.velocity is None
    assert (case.before.gaussians.means == model.read(0).means).all()
    velocity = keyframe.open_case(scene, model.folder, 2, None).before.velocity
    assert (velocity == model.read(1).means - model.read(0).means).all()
    assert len(case.warm(2)) >= len(case.before.gaussians)


@pytest.mark.parametrize(("frame", "message"), [(0, "from 1 to 2, got 0"), (3, "got 3"), (None, "expected a keyframe")])
def test_frames_that_cannot_be_compared_are_refused(scene, model, frame, message):
    with pytest.raises(ConfigError, match=message):
        keyframe.open_case(scene, model.folder, frame, None)


def test_both_curves_are_followed(scene, model, tmp_path, monkeypatch):
    monkeypatch.setattr(keyframe, "WARM", (2,))
    monkeypatch.setattr(keyframe, "SCRATCH", (2, 4))
    page = keyframe.run(keyframe.Options(scene, model.folder, frame=1), Lab.at(tmp_path))
    (section,), rows = page.sections, page.data[0].rows
    assert [(row["fitted"], row["iterations"]) for row in rows] == [
        ("from the frame before", 2),
        ("from scratch", 2),
        ("from scratch", 4),
    ]
    assert all(row["psnr"] > 0 and row["rows"] > 0 for row in rows) and "The frame before has " in section.answer


def curve(name, *points):
    return [{"fitted": name, "iterations": 9, "seconds": s, "psnr": psnr, "rows": 110} for s, psnr in points]


def test_how_much_sooner_is_told_of_the_best_that_both_reach():
    fast = curve("from the frame before", (1.0, 30.0), (2.0, 33.0), (4.0, 33.5))
    (section,) = keyframe.page(100, fast, curve("from scratch", (3.0, 31.0), (8.0, 33.2), (20.0, 34.0))).sections
    assert section.answer == (
        "What a fit from scratch shows after 8.0 s (33.2 dB), one from the frame before shows after 4.0 s, 2.0 times "
        "sooner. The frame before has 100 Gaussians, to which at most 10.0 % are added."
    )
    (section,) = keyframe.page(100, fast, curve("from scratch", (3.0, 34.0))).sections
    assert section.answer.startswith("No fit from the frame before shows what")
