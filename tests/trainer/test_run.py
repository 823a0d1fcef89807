"""Whole training runs: groups, keyframes, exposure."""

import itertools
import json
import shutil
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

import airgs_codec as airgs
from airgs_codec.analysis.grouping import plan_groups
from airgs_codec.places.whole import to_json
from airgs_codec.trainer.frames import is_known
from airgs_codec.trainer.settings import settings_from_table
from tests.faces import (
    CPU,
    ConfigError,
    GroupSpan,
    SceneError,
    Temporal,
    Trainer,
    TrainingError,
    TrainSettings,
    ViewPlan,
    open_scene,
    open_sequence,
    preset,
    survey_group,
    train,
    with_held_out,
)
from tests.support.training import APPEARS, SETTINGS
from tests.support.views import coloured_cloud, measure_usage, ring

COLUMNS = ("means", "quaternions", "log_scales", "opacity_logits", "sh_dc")


def test_a_keyframe_is_found_where_something_appears(run):
    assert run.record.keyframes() == [0, APPEARS]
    key = run.record.frames[APPEARS]
    assert key.kind == "key" and key.added > 0
    assert key.rejected_psnr < key.psnr - 2
    counts = [f.gaussians for f in run.record.frames]
    assert len(set(counts[:APPEARS])) == len(set(counts[APPEARS:])) == 1
    assert max(counts) <= SETTINGS.capacity
    for f in run.record.frames:
        assert f.psnr > 20 and 0 < f.held_out_ssim <= 1 and f.held_out_psnr > 15
    assert run.record.warnings() == []


def test_usage_is_of_all_frames_and_the_encoder_takes_it(run):
    sequence = open_sequence(run.folder)
    training = [c for c in sequence.cameras if c.split == "train"]
    (start, stop) = plan_groups(sequence).spans[0]
    saved = sequence.usage(start, stop)
    measured = measure_usage([sequence.read(t) for t in range(start, stop)], training)
    np.testing.assert_allclose(saved.total, measured.total)
    np.testing.assert_array_equal(saved.hits, measured.hits)
    survey = survey_group(sequence, GroupSpan(0, start, stop), ViewPlan.of(sequence, 24))
    assert survey.usage.total.tolist() == saved.total.tolist()
    assert sequence.usage(0, 2) is None  # another group: measured anew


def test_a_model_is_a_sequence(run):
    sequence = open_sequence(run.folder)
    assert len(sequence) == 5 and sequence.keyframes == (0, APPEARS) and sequence.fps == 12
    assert [c.split for c in sequence.cameras] == ["train"] * 6 + ["test"]
    assert sequence.cameras[0].world_to_camera == pytest.approx(ring(7)[0].world_to_camera, abs=1e-6)


def test_runs_of_one_seed_are_alike_and_of_another_are_not(blobs, tmp_path):
    scene = open_scene(blobs, frames=(0, 1))
    for name, seed in (("a", 0), ("b", 1), ("c", 0)):
        train(scene, tmp_path / name, replace(SETTINGS, seed=seed, first_iterations=60))
    first, other, same = ((tmp_path / name / "000000.ply").read_bytes() for name in "abc")
    assert first == same and first != other


def exposed(blobs, folder, camera, gain):
    """The scene with brighter or darker pictures of one camera."""
    scene = shutil.copytree(blobs, folder / "scene")
    for path in (scene / "images" / camera).glob("*.png"):
        cv2.imwrite(str(path), np.clip(cv2.imread(str(path)) * gain, 0, 255).astype(np.uint8))
    return scene


@pytest.mark.parametrize("match", ["on", "auto"])
def test_exposure_is_found(blobs, tmp_path, match):
    """One camera that is 20 % brighter gets that gain, and pictures of the run are corrected by it."""
    settings = replace(SETTINGS, match_exposure=match, first_iterations=500)
    model = train(open_scene(exposed(blobs, tmp_path, "cam01", 1.2), frames=(0, 2)), tmp_path / "m", settings)
    gains = {name: np.mean(values[:3]) for name, values in model.record.exposure.items()}
    assert gains["cam01"] - np.mean([g for n, g in gains.items() if n != "cam01"]) == pytest.approx(0.2, abs=0.08)
    assert np.mean(list(gains.values())) == pytest.approx(1.0, abs=0.01)


def test_cameras_that_are_alike_are_left_as_they_are(blobs, tmp_path):
    settings = replace(SETTINGS, first_iterations=500)
    assert train(open_scene(blobs, frames=(0, 1)), tmp_path / "m", settings).record.exposure == {}


def test_held_out_views_are_judged_as_they_are_and_with_their_exposure_matched(blobs, tmp_path):
    scene = open_scene(blobs, frames=(0, 1))
    [held_out] = [camera.name for camera in scene.cameras if camera.held_out]
    alike = train(scene, tmp_path / "alike", SETTINGS).record.frames[0]
    scene = open_scene(exposed(blobs, tmp_path, held_out, 0.7), frames=(0, 1))
    darker = train(scene, tmp_path / "darker", SETTINGS).record.frames[0]
    assert darker.held_out_matched > darker.held_out_psnr + 1
    assert alike.held_out_matched >= alike.held_out_psnr and darker.psnr == alike.psnr
    error = 10 ** (-darker.held_out_matched / 20) / 10 ** (-alike.held_out_matched / 20)
    assert error == pytest.approx(0.7, abs=0.05)  # of what is shown in the same way, darker


def test_the_reference_keeps_its_exposure(blobs, tmp_path):
    settings = replace(SETTINGS, match_exposure="on", reference="cam01", first_iterations=60)
    model = train(open_scene(blobs, frames=(0, 1)), tmp_path / "m", settings)
    assert model.record.exposure["cam01"] == [1, 1, 1, 0, 0, 0]
    assert any(values != [1, 1, 1, 0, 0, 0] for values in model.record.exposure.values())


def test_a_reference_that_is_no_training_camera_leaves_nothing(blobs, tmp_path):
    settings = replace(SETTINGS, match_exposure="on", reference="cam99")
    with pytest.raises(ConfigError, match="expected a training camera of cam"):
        train(open_scene(blobs), tmp_path / "m", settings)
    assert not (tmp_path / "m").exists()


def _without_picture(folder):
    (folder / "images" / "cam02" / "0001.png").unlink()
    return open_scene(folder)


def _alone(folder):
    return replace(with_held_out(open_scene(folder), [f"cam0{i}" for i in range(1, 7)]), points=None)


def _back_to_back(folder):
    """Cameras that stand in a ring and look outwards."""
    scene = open_scene(folder)

    def turned(shot):
        flip = np.diag([-1.0, 1.0, -1.0, 1.0])
        return replace(shot, camera=replace(shot.camera, world_to_camera=flip @ shot.camera.world_to_camera))

    frames = tuple(tuple(turned(shot) for shot in shots[::3]) for shots in scene.frames)
    return replace(scene, frames=frames, points=None)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (_without_picture, "cam02/0001.png: expected a picture"),
        (_alone, "expected a cloud of points or at least two training views, got one view"),
        (_back_to_back, "expected training views that look at a common place: no point to start from was found"),
    ],
)
def test_what_cannot_be_trained_is_refused_and_leaves_nothing(blobs, tmp_path, make, message):
    shutil.copytree(blobs, tmp_path / "scene")
    with pytest.raises(SceneError, match=message):
        train(make(tmp_path / "scene"), tmp_path / "m", SETTINGS)
    assert not (tmp_path / "m").exists()


def test_a_first_fit_that_fails_leaves_nothing(blobs, tmp_path, monkeypatch):
    def fail(*_):
        raise TrainingError("the loss is not finite")

    monkeypatch.setattr("airgs_codec.trainer.frames.fit_first", fail)
    with pytest.raises(TrainingError):
        train(open_scene(blobs), tmp_path / "m", SETTINGS)
    assert not (tmp_path / "m").exists()


def test_a_keyframe_that_is_no_better_is_not_kept(blobs, tmp_path, monkeypatch):
    monkeypatch.setattr(Trainer, "fit_keyframe", lambda self, target, before, steps, progress: before.gaussians)
    settings = replace(SETTINGS, min_psnr_db=99.0, first_iterations=60)
    model = train(open_scene(blobs, frames=(0, 3)), tmp_path / "m", settings)
    assert model.record.keyframes() == [0]
    assert [f.added for f in model.record.frames] == [0, 0, 0]
    assert len({f.gaussians for f in model.record.frames}) == 1
    assert all(f.rejected_psnr <= f.psnr for f in model.record.frames[1:])


def test_what_rests_is_the_same_bit_for_bit_over_frames_and_keyframes(run):
    frames = [run.read(t) for t in range(5)]
    rows = len(frames[0])
    same = np.ones(rows, bool)
    for a, b in itertools.pairwise(frames):
        same &= np.all([(getattr(a, n)[:rows] == getattr(b, n)[:rows]).reshape(rows, -1).all(1) for n in COLUMNS], 0)
    assert same.mean() > 0.2


def test_without_plates_nothing_is_known_to_rest(blobs, tmp_path, run):
    settings = replace(SETTINGS, static="off", temporal=Temporal(weight=0.0))
    model = train(open_scene(blobs, frames=(0, 2)), tmp_path / "m", settings)
    assert (model.read(0).means == model.read(1).means).all(axis=1).mean() < 0.2


def test_python_trains_a_path_into_a_folder_beside_it_and_encodes_that(blobs, tmp_path):
    scene = shutil.copytree(blobs, tmp_path / "blobs")
    told = []
    settings = replace(SETTINGS, first_iterations=5, key_iterations=2, frame_iterations=2, min_psnr_db=0)
    model = airgs.train(scene, settings=settings, device="cpu", progress=lambda *words: told.append(words))
    assert model.folder == tmp_path / "blobs.gaussians"
    whole = [words[1:] for words in told if words[0].startswith("training: frame ")]
    assert whole == sorted(whole) and whole[-1][0] == whole[-1][1] and whole[0][1] < whole[-1][1]  # a keyframe more
    assert [frame.frame for frame in model.record.frames] == list(range(len(airgs.open_sequence(model.folder))))
    with pytest.raises(ConfigError, match="scene: expected a multi-view scene or the path of one, got int 5"):
        airgs.train(5)


def test_keyframes_may_have_half_as_many_more_than_the_first_frame(blobs, tmp_path):
    """Unless the settings say how many, which may be fewer than they wished the first frame to have."""
    few = replace(SETTINGS, budget=4000, capacity=None, first_iterations=20, key_iterations=60, max_growth=9.0)
    model = train(open_scene(blobs), tmp_path / "m", few)
    counts = [frame.gaussians for frame in model.record.frames]
    assert counts[0] < counts[-1] <= 4000
    model = train(open_scene(blobs), tmp_path / "n", replace(few, budget=None))
    counts = [frame.gaussians for frame in model.record.frames]
    assert counts[0] < counts[-1] <= 1.5 * counts[0]


@pytest.mark.parametrize(("spread", "noise"), [(True, True), (False, False)], ids=["everywhere", "in a corner"])
def test_noise_is_spread_and_lost_motion_is_not(spread, noise):
    g, rng = coloured_cloud(), np.random.default_rng(0)
    views = []
    for camera in ring(3):
        drawn = CPU.load(g).draw(camera).rgb
        error = 0.05 * rng.normal(size=drawn.shape)
        if not spread:
            error[drawn.shape[0] // 2 :] *= 1e-3
            error[:, drawn.shape[1] // 4 :] *= 1e-3
        target = (drawn + error * (np.abs(drawn) > 0.01)).astype(np.float32)
        views.append(SimpleNamespace(camera=camera, target=SimpleNamespace(rgb=target)))
    assert is_known(SimpleNamespace(renderer=CPU), g, views) == noise


@pytest.mark.parametrize(
    "wrong",
    [
        {"budget": 0},
        {"budget": 6, "capacity": 5},
        {"sh_degree": 4},
        {"deltas": "x"},
        {"densify": "x"},
        {"max_drop_db": 0.0},
        {"temporal": Temporal(until=0.0)},
    ],
)
def test_settings_that_cannot_work_are_refused(wrong):
    with pytest.raises(ConfigError, match="expected"):
        TrainSettings(**wrong)


@pytest.mark.parametrize("name", ["default", "paper"])
def test_settings_come_back_from_their_table(name):
    settings = preset(name, TrainSettings(seed=3, max_size=64))
    assert settings_from_table(json.loads(to_json(settings.table()))) == settings


@pytest.mark.parametrize(("views", "expected"), [(16, 2500), (84, 5040)])
def test_a_first_frame_sees_every_view_often(views, expected):
    assert TrainSettings().iterations_from_scratch(views) == expected
    assert TrainSettings(first_iterations=7).iterations_from_scratch(views) == 7
