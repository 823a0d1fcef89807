"""The keyframe benchmark: its options mean what they say, and a frame without a history has no velocity."""

from dataclasses import replace

import pytest

from airgs_codec.errors import ConfigError
from airgs_codec.train.data.readers import open_scene
from airgs_codec.train.run import train
from tests.support.training import SETTINGS, write_blobs
from tools import bench_keyframe


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return write_blobs(tmp_path_factory.mktemp("scene") / "blobs")


@pytest.fixture(scope="module")
def model(scene, tmp_path_factory):
    settings = replace(SETTINGS, budget=150, first_iterations=10, frame_iterations=2, min_psnr_db=1.0, max_drop_db=99.0)
    return train(open_scene(scene, frames=(0, 3)), tmp_path_factory.mktemp("models") / "m", settings)


def test_pictures_are_shrunk_as_asked(scene, model):
    case = bench_keyframe.open_case(scene, model.folder, 1, max_size=24)
    assert {view.camera.width for view in [*case.target.views, *case.held_out]} == {24}
    assert {v.camera.width for v in bench_keyframe.open_case(scene, model.folder, 1, None).target.views} == {40}


def test_the_second_frame_of_a_group_has_no_velocity(scene, model):
    case = bench_keyframe.open_case(scene, model.folder, 1, None)
    assert case.before.velocity is None
    assert (case.before.gaussians.means == model.read(0).means).all()
    velocity = bench_keyframe.open_case(scene, model.folder, 2, None).before.velocity
    assert (velocity == model.read(1).means - model.read(0).means).all()
    assert len(case.warm(2)) >= len(case.before.gaussians)


@pytest.mark.parametrize(("frame", "message"), [(0, "from 1 to 2, got 0"), (3, "got 3"), (None, "expected a keyframe")])
def test_frames_that_cannot_be_compared_are_refused(scene, model, frame, message, capsys):
    with pytest.raises(ConfigError, match=message):
        bench_keyframe.open_case(scene, model.folder, frame, None)
    words = [str(scene), str(model.folder), *(() if frame is None else ("--frame", str(frame)))]
    assert bench_keyframe.main(words) == 2
    assert capsys.readouterr().err.count("\n") == 1
