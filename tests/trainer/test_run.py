"""Whole training runs: groups, keyframes, exposure, what they leave behind and what is said of them."""

import itertools
import json
import shutil
from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import Mock

import cv2
import numpy as np
import pytest

import airgs_codec as airgs
from airgs_codec.trainer.frames import is_known
from airgs_codec.trainer.report import training_answer
from tests import faces
from tests.faces import ConfigError, FrameRecord, Record, SceneError, TrainSettings, open_scene, train
from tests.support.training import APPEARS, SETTINGS, files
from tests.support.views import coloured_cloud, measure_usage, ring

QUICK = replace(SETTINGS, first_iterations=10, keyframe_iterations=2, frame_iterations=2)


@pytest.fixture
def run(model_of):
    return faces.read_model(model_of("blobs"))


def test_a_keyframe_is_found_where_something_appears(run):
    assert run.record.keyframes() == [0, APPEARS]
    key = run.record.frames[APPEARS]
    assert key.kind == "keyframe" and key.added > 0 and key.rejected_psnr < key.psnr - 2
    counts = [f.gaussians for f in run.record.frames]
    assert len(set(counts[:APPEARS])) == len(set(counts[APPEARS:])) == 1 and max(counts) <= SETTINGS.capacity
    for f in run.record.frames:
        assert f.psnr > 20 and 0 < f.held_out_ssim <= 1 and f.held_out_psnr > 15
    assert run.record.warnings() == [] and run.record.exposure == {}  # cameras that are alike are left as they are


def test_a_model_is_a_sequence_with_the_usage_of_all_frames_which_the_encoder_takes(run):
    sequence = faces.open_sequence(run.folder)
    assert len(sequence) == 5 and sequence.keyframes == (0, APPEARS) and sequence.fps == 12
    assert [c.split for c in sequence.cameras] == ["train"] * 6 + ["test"]
    assert sequence.cameras[0].world_to_camera == pytest.approx(ring(7)[0].world_to_camera, abs=1e-6)
    saved = sequence.usage(0, APPEARS)
    measured = measure_usage([sequence.read(t) for t in range(APPEARS)], sequence.cameras[:6])
    np.testing.assert_allclose(saved.total, measured.total)
    np.testing.assert_array_equal(saved.hits, measured.hits)
    views = faces.choose_views(sequence, faces.EncodeSettings())[0]
    survey = faces.Survey.of(faces.Frames(sequence, 0, ((0, APPEARS),)), views, faces.CPU)
    assert survey.usage.total.tolist() == saved.total.tolist()
    assert sequence.usage(0, 2) is None  # another group: measured anew


def test_what_rests_is_the_same_bit_for_bit_over_frames_and_keyframes(run):
    frames = [run.read(t) for t in range(5)]
    rows = len(frames[0])
    same = np.ones(rows, bool)
    for a, b in itertools.pairwise(frames):
        for name in ("means", "quaternions", "log_scales", "opacity_logits", "sh_dc"):
            same &= (getattr(a, name)[:rows] == getattr(b, name)[:rows]).reshape(rows, -1).all(1)
    assert same.mean() > 0.2


@pytest.mark.parametrize("frames", [APPEARS, 4])
def test_a_run_that_was_cut_off_between_frame_and_record_repeats_that_frame(run, blobs, tmp_path, frames):
    """Where the keyframe is found, and behind it."""
    folder = shutil.copytree(run.folder, tmp_path / "m")
    (folder / "usage.npz").unlink()
    record = json.loads((folder / "training.json").read_text())
    record["frames"] = record["frames"][:frames]
    (folder / "training.json").write_text(json.dumps(record))
    (folder / "000004.ply").write_bytes(b"half a frame")
    (folder / ".000004.ply.0123456789abcdef.part").write_bytes(b"half a frame")
    train(open_scene(blobs), folder, SETTINGS, resume=True)
    assert files(folder) == files(run.folder)


def test_what_is_there_is_never_lost_and_a_finished_run_is_left_alone(run, blobs, tmp_path):
    (tmp_path / "thesis.txt").write_text("mine")
    scene = open_scene(blobs)
    fewer = replace(scene, frames=tuple(f[:-1] for f in scene.frames))
    before = {p.name: p.stat().st_mtime_ns for p in run.folder.glob("*.ply")}
    for views, folder, settings, resume, message in (
        (scene, run.folder, SETTINGS, False, r"resume .* goes on with"),
        (scene, run.folder, replace(SETTINGS, budget=261), True, "has budget 260, not 261"),
        (fewer, run.folder, SETTINGS, True, "the run there has cameras"),
        (faces.with_near(scene, 0.5), run.folder, SETTINGS, True, "the run there has cameras"),
        (scene, tmp_path, SETTINGS, False, "a folder with other files"),
    ):
        with pytest.raises(ConfigError, match=message):
            train(views, folder, settings, resume=resume)
    assert (tmp_path / "thesis.txt").read_text() == "mine"
    assert train(scene, run.folder, SETTINGS, resume=True).finished()
    assert {p.name: p.stat().st_mtime_ns for p in run.folder.glob("*.ply")} == before


def exposed(blobs, folder, camera, gain):
    scene = shutil.copytree(blobs, folder / "scene")
    for path in (scene / "images" / camera).glob("*.png"):
        cv2.imwrite(str(path), np.clip(cv2.imread(str(path)) * gain, 0, 255).astype(np.uint8))
    return scene


@pytest.mark.parametrize(("match", "reference"), [("auto", None), ("on", "cam01")])
def test_exposure_is_found(blobs, tmp_path, match, reference):
    """One camera that is 20 % brighter gets that gain, or all others lose it where that one is the reference."""
    settings = replace(SETTINGS, match_exposure=match, reference=reference, first_iterations=200)
    scene = open_scene(exposed(blobs, tmp_path, "cam01", 1.2), frames=(0, 1))
    found = train(scene, tmp_path / "m", settings).record.exposure
    gains = {name: np.mean(values[:3]) for name, values in found.items()}
    bright = gains.pop("cam01")
    assert bright / np.mean(list(gains.values())) - 1 == pytest.approx(0.2, abs=0.08)
    if reference is None:
        assert np.mean([bright, *gains.values()]) == pytest.approx(1.0, abs=0.01)
    else:
        assert found["cam01"] == [1, 1, 1, 0, 0, 0]


def test_held_out_views_are_judged_as_they_are_and_with_their_exposure_matched(run, blobs, tmp_path):
    alike = run.record.frames[0]
    scene = open_scene(exposed(blobs, tmp_path, "cam06", 0.7))
    assert [camera.name for camera in scene.cameras if camera.held_out] == ["cam06"]
    darker = next(faces.train_frames(faces.open_run(scene, tmp_path / "m", SETTINGS)))
    assert darker.held_out_matched > darker.held_out_psnr + 1
    assert alike.held_out_matched >= alike.held_out_psnr and darker.psnr == alike.psnr
    error = 10 ** (-darker.held_out_matched / 20) / 10 ** (-alike.held_out_matched / 20)
    assert error == pytest.approx(0.7, abs=0.05)  # of what is shown in the same way, darker


def without_a_picture(scene):
    scene.frames[1][1].source.path.unlink()
    return scene


def of_cameras_that_look_outwards(scene):
    def turned(shot):
        flip = np.diag([-1.0, 1.0, -1.0, 1.0])
        return replace(shot, camera=replace(shot.camera, world_to_camera=flip @ shot.camera.world_to_camera))

    frames = tuple(tuple(turned(shot) for shot in shots[::3]) for shots in scene.frames)
    return replace(scene, frames=frames, points=None)


@pytest.mark.parametrize(("change", "reference", "message"), [
    (None, "cam99", "expected a training camera of cam"),
    (without_a_picture, None, "cam01/0001.png: expected a picture"),
    (lambda scene: replace(faces.with_held_out(scene, [f"cam0{i}" for i in range(1, 7)]), points=None), None,
     "expected a cloud of points or at least two training views, got one view"),
    (of_cameras_that_look_outwards, None, "views that look at a common place: no point to start from was found"),
    (None, None, "the loss is not finite"),
])  # fmt: skip
def test_what_cannot_be_trained_is_refused_and_leaves_nothing(blobs, tmp_path, monkeypatch, change, reference, message):
    if "finite" in message:
        fails = Mock(side_effect=faces.TrainingError("the loss is not finite"))
        monkeypatch.setattr("airgs_codec.trainer.frames.fit_first", fails)
    scene = open_scene(shutil.copytree(blobs, tmp_path / "scene"))
    scene = change(scene) if change else scene
    with pytest.raises((ConfigError, SceneError, faces.TrainingError), match=message):
        train(scene, tmp_path / "m", replace(SETTINGS, match_exposure="on", reference=reference))
    assert not (tmp_path / "m").exists()


@pytest.mark.parametrize(("preset", "least", "keyframes", "tried"), [
    ("default", 99.0, [0],       True),
    ("paper",   99.0, [0, 1, 2], True),
    ("paper",    0.0, [0],       False),  # though what appears costs decibels
])  # fmt: skip
def test_a_keyframe_that_is_no_better_is_kept_by_the_paper_alone(
    blobs, tmp_path, monkeypatch, preset, least, keyframes, tried
):
    monkeypatch.setattr(faces.Trainer, "fit_keyframe", lambda self, target, before, steps, progress: before)
    settings = replace(faces.preset(preset, QUICK), min_psnr_db=least)
    first, *others = train(open_scene(blobs, frames=(1, 4)), tmp_path / "m", settings).record.frames
    assert [f.frame for f in (first, *others) if f.kind != "frame"] == keyframes
    assert {f.added for f in (first, *others)} == {0} and {f.gaussians for f in others} == {first.gaussians}
    assert [f.rejected_psnr is not None for f in others] == [tried] * 2
    assert all(f.rejected_psnr <= f.psnr for f in others if f.kind == "frame" and tried)


def test_python_trains_a_path_into_a_folder_beside_it_and_encodes_that(blobs, tmp_path):
    scene = shutil.copytree(blobs, tmp_path / "blobs")
    told = []
    settings = replace(QUICK, first_iterations=5, min_psnr_db=0)
    model = airgs.train(scene, settings=settings, device="cpu", progress=lambda *words: told.append(words))
    assert model.folder == tmp_path / "blobs.gaussians"
    whole = [words[1:] for words in told if words[0].startswith("training: frame ")]
    assert whole == sorted(whole) and whole[-1][0] == whole[-1][1] and whole[0][1] < whole[-1][1]  # a keyframe more
    assert [frame.frame for frame in model.record.frames] == list(range(len(airgs.open_sequence(model.folder))))
    with pytest.raises(ConfigError, match=r"scene: expected a multi-view scene, .* the path of one, got int 5"):
        airgs.train(5)


@pytest.mark.parametrize(("spread", "noise"), [(True, True), (False, False)], ids=["everywhere", "in a corner"])
def test_noise_is_spread_and_lost_motion_is_not(spread, noise):
    g, rng = coloured_cloud(), np.random.default_rng(0)
    views = []
    for camera in ring(3):
        drawn = faces.CPU.load(g).draw(camera).rgb
        error = 0.05 * rng.normal(size=drawn.shape)
        if not spread:
            error[drawn.shape[0] // 2 :] *= 1e-3
            error[:, drawn.shape[1] // 4 :] *= 1e-3
        target = (drawn + error * (np.abs(drawn) > 0.01)).astype(np.float32)
        views.append(SimpleNamespace(camera=camera, target=SimpleNamespace(rgb=target)))
    assert is_known(SimpleNamespace(renderer=faces.CPU), g, views) == noise


@pytest.mark.parametrize("wrong", [
    {"budget": 0}, {"budget": 6, "capacity": 5}, {"sh_degree": 4}, {"deltas": "x"}, {"densify": "x"},
    {"max_drop_db": 0.0}, {"temporal": faces.Temporal(until=0.0)},
])  # fmt: skip
def test_settings_that_cannot_work_are_refused(wrong):
    with pytest.raises(ConfigError, match="expected"):
        TrainSettings(**wrong)


def test_a_first_frame_sees_every_view_often():
    for settings, expected in ((TrainSettings(), [1500, 3024]), (TrainSettings(first_iterations=7), [7, 7])):
        assert [settings.iterations_from_scratch(views) for views in (16, 84)] == expected


def test_the_quality_of_a_run_is_said_with_exposure_matched_where_it_differs(run):
    alike = replace(run.record, exposure={})
    assert "held out" in alike.quality() and "matched" not in alike.quality()
    exposed = replace(alike, exposure={"cam00": [1.1, 1.0, 1.0, 0.0, 0.0, 0.0]})
    assert exposed.quality().endswith(" with their exposure matched")
    first = replace(alike.frames[0], held_out_psnr=None, held_out_matched=None)
    trained = f"the trained model is itself at {first.psnr:.1f} dB to the pictures it was trained on"
    assert replace(exposed, frames=(first,)).quality() == f"qualities are those of the coding: {trained}"


def frame(number, psnr, held_out=None, **changes):
    kind, exposed = "frame" if number else "first", None if held_out is None else held_out + 0.1
    return replace(FrameRecord(number, kind, 900, 0, psnr, held_out, exposed, None, None, 2.0), **changes)


CAMERA = "cam03 in it with 27.0"
STEADY = [frame(t, 33.0 - 0.01 * t, 32.0 - 0.01 * t) for t in range(6)]
GUESSED = [frame(t, 36.0 - 0.1 * t, 31.0) for t in range(4)]
EXPOSED = [replace(f, held_out_matched=f.held_out_psnr + 2) for f in STEADY]
FALLING = [frame(t, 34.0 - t, 33.0 - t) for t in range(6)]
UNDONE = [frame(0, 32.0, 31.0), frame(1, 32.5, 31.0), frame(2, 32.5, 31.0)]


@pytest.mark.parametrize(("frames", "field", "there", "absent"), [
    (STEADY, "good", "Cameras that were held out see 32.0 dB, those trained on 33.0 dB.", "This page fills"),
    (STEADY, "good", "900 Gaussians and took about 12 s", "of a budget"),
    (STEADY, "wrong", "Frame 5 is the lowest with 31.9 dB, camera cam03 in it with 27.0.", "far below"),
    (STEADY, "change", "Nothing", ""),
    ([frame(t, 33.0) for t in range(3)], "good", "none is held out", "held out see"),
    ([*STEADY[:5], frame(5, 33.0, 25.0)], "wrong", "far below", ""),
    (GUESSED, "wrong", "4.9 dB less than those trained on", ""),
    (GUESSED, "change", "--budget", ""),
    (EXPOSED, "wrong", "2.0 dB of the error are the exposure", ""),
    (EXPOSED, "change", "--match-exposure on", ""),
    (FALLING, "wrong", "last third of the frames shows 4.0 dB less", ""),
    (FALLING, "change", "--max-drop 1.5", ""),
    # A second frame only moves the first: where it shows more though the scene has moved, the first was not done.
    (UNDONE, "wrong", "0.50 dB more", ""),
    (UNDONE, "change", "--iterations", ""),
    ([UNDONE[0], replace(UNDONE[1], kind="keyframe"), UNDONE[2]], "change", "", "--iterations"),
])  # fmt: skip
def test_every_sentence_is_said_where_the_frames_say_so(frames, field, there, absent):
    said = training_answer(Record({}, TrainSettings().table(), len(frames), "30", tuple(frames)), CAMERA)[field]
    assert there in said and (not absent or absent not in said)


def test_a_run_that_goes_on_says_how_long_and_budgets_are_told():
    good = training_answer(Record({}, TrainSettings(budget=1000).table(), 10, "30", tuple(STEADY)), CAMERA)["good"]
    assert good.startswith("6 of 10 frames are trained; the others take about 8 s. This page fills.")
    assert "900 Gaussians of a budget of 1,000" in good
