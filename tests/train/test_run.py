"""Whole training runs: groups, resuming, what is left behind, the commands."""

import json
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest

from airgs_codec.analysis.grouping import plan_groups
from airgs_codec.analysis.usage import measure_usage
from airgs_codec.cli.encode import main as encode_main
from airgs_codec.cli.train import main as train_main
from airgs_codec.encoder.plan import survey_group
from airgs_codec.errors import ConfigError, SceneError
from airgs_codec.inspect.validate import validate
from airgs_codec.package.store import open_package
from airgs_codec.scene.sequence import open_sequence
from airgs_codec.scene.usage import load_usage
from airgs_codec.train.data.readers import open_scene
from airgs_codec.train.run import train
from airgs_codec.train.settings import TrainSettings
from tests.support.views import appeared, coloured_cloud, joined, moved, ring, write_views

SETTINGS = TrainSettings(
    budget=260,
    capacity=400,
    sh_degree=0,
    first_iterations=140,
    key_iterations=120,
    frame_iterations=25,
    added=0.4,
    drop=3.0,
    tau=18.0,
)
APPEARS = 3  # frame


@pytest.fixture(scope="session")
def scene_folder(tmp_path_factory):
    """Five frames; a part moves, and at APPEARS something comes into empty space."""
    g = coloured_cloud(120)
    frames = []
    for t in range(5):
        now = moved(g, slice(0, 20), (0.02 * t, 0.0, 0.0))
        frames.append(joined(now, appeared()) if t >= APPEARS else now)
    folder = write_views(tmp_path_factory.mktemp("scene") / "blobs", frames, ring(7, size=40, held_out=1), g.means)
    (folder / "ATTRIBUTION.txt").write_text("blobs by nobody\n")
    return folder


@pytest.fixture(scope="session")
def run(scene_folder, tmp_path_factory):
    """An unbroken run."""
    return train(open_scene(scene_folder), tmp_path_factory.mktemp("models") / "blobs", SETTINGS)


class StopError(Exception):
    """A run that is killed."""


def killed_at(frame: int, iteration: int):
    def progress(what, done, total):
        if what.startswith(f"frame {frame} ") and done == iteration:
            raise StopError

    return progress


def files(folder):
    """Everything that a run decides; seconds are the machine's."""
    found = {p.name: p.read_bytes() for p in folder.iterdir() if p.name != "training.json"}
    record = json.loads((folder / "training.json").read_text())
    for frame in record["frames"]:
        frame.pop("seconds")
    return found, record


def test_a_keyframe_is_found_where_something_appears(run):
    assert run.record.keyframes() == [0, APPEARS]
    key = run.record.frames[APPEARS]
    assert key.kind == "key" and key.added > 0
    assert key.rejected_psnr < key.psnr - 2
    counts = [f.gaussians for f in run.record.frames]
    assert len(set(counts[:APPEARS])) == len(set(counts[APPEARS:])) == 1
    assert max(counts) <= SETTINGS.capacity


def test_rows_go_on_over_the_keyframe(run):
    before, after = run.read(APPEARS - 1), run.read(APPEARS)
    still = np.linalg.norm(after.means[: len(before)] - before.means, axis=1)
    unrelated = np.linalg.norm(np.roll(before.means, 7, axis=0) - before.means, axis=1)
    assert np.median(still) < 0.05 * np.median(unrelated)


def test_the_record_says_what_moved_and_how_good_it_is(run):
    for f in run.record.frames:
        assert f.psnr > 20 and 0 < f.held_out_ssim <= 1 and f.held_out_psnr > 15
        assert bool(f.static) == (f.kind == "frame")
        assert all(0 <= share <= 1 for share in f.static.values())
    assert "sh_rest" not in run.record.frames[1].static  # there is none


def test_a_model_is_a_sequence_that_encodes(run, tmp_path):
    sequence = open_sequence(run.folder)
    assert len(sequence) == 5 and sequence.keyframes == (0, APPEARS) and sequence.fps == 12
    assert [c.split for c in sequence.cameras] == ["train"] * 6 + ["test"]
    assert sequence.cameras[0].world_to_camera == pytest.approx(ring(7)[0].world_to_camera, abs=1e-6)
    assert (
        encode_main([str(run.folder), "-o", str(tmp_path / "p"), "--preset", "ultrafast", "--measure-frames", "1"]) == 0
    )
    assert not validate(tmp_path / "p")


def test_usage_is_of_all_frames_and_the_encoder_takes_it(run):
    sequence = open_sequence(run.folder)
    training = [c for c in sequence.cameras if c.split == "train"]
    (start, stop) = plan_groups(sequence).spans[0]
    saved = sequence.usage(start, stop)
    measured = measure_usage([sequence.read(t) for t in range(start, stop)], training)
    np.testing.assert_allclose(saved.total, measured.total)
    np.testing.assert_array_equal(saved.hits, measured.hits)
    assert saved.moved.min() >= 0 and saved.moved.max() > 0
    assert survey_group(sequence, 0, start, stop, training).usage.total.tolist() == saved.total.tolist()
    assert sequence.usage(0, 2) is None  # another group: measured anew


@pytest.mark.parametrize("deltas", ["direct", "mlp+residual"])
@pytest.mark.parametrize("killed", [(0, 70), (2, 9), (APPEARS, 30), (4, 1)])
def test_a_killed_run_goes_on_to_the_same_end(scene_folder, tmp_path, deltas, killed, unbroken):
    settings = replace(SETTINGS, deltas=deltas)
    scene = open_scene(scene_folder)
    with pytest.raises(StopError):
        train(scene, tmp_path / "m", settings, progress=killed_at(*killed))
    assert len(list((tmp_path / "m").glob("*.ply"))) == killed[0]  # finished frames are there
    train(scene, tmp_path / "m", settings, resume=True)
    assert files(tmp_path / "m") == files(unbroken(deltas))


@pytest.fixture(scope="session")
def unbroken(scene_folder, tmp_path_factory, run):
    """Folders of unbroken runs."""
    made = {"direct": run.folder}

    def get(deltas):
        if deltas not in made:
            folder = tmp_path_factory.mktemp("models") / deltas
            train(open_scene(scene_folder), folder, replace(SETTINGS, deltas=deltas))
            made[deltas] = folder
        return made[deltas]

    return get


def test_a_run_killed_between_frame_and_record_repeats_that_frame(run, scene_folder, tmp_path):
    folder = tmp_path / "m"
    shutil.copytree(run.folder, folder)
    (folder / "usage.npz").unlink()
    record = json.loads((folder / "training.json").read_text())
    record["frames"].pop()
    (folder / "training.json").write_text(json.dumps(record))
    (folder / "000004.ply").write_bytes(b"half a frame")
    (folder / ".000004.ply.part").write_bytes(b"half a frame")
    train(open_scene(scene_folder), folder, SETTINGS, resume=True)
    assert files(folder) == files(run.folder)


def test_a_finished_run_is_left_alone(run, scene_folder):
    before = {p.name: p.stat().st_mtime_ns for p in run.folder.glob("*.ply")}
    assert train(open_scene(scene_folder), run.folder, SETTINGS, resume=True).finished()
    assert {p.name: p.stat().st_mtime_ns for p in run.folder.glob("*.ply")} == before


def test_runs_of_one_seed_are_alike_and_of_another_are_not(run, scene_folder, tmp_path):
    scene = open_scene(scene_folder, frames=(0, 1))
    for name, seed in (("a", 0), ("b", 1)):
        train(scene, tmp_path / name, replace(SETTINGS, seed=seed))
    first = (run.folder / "000000.ply").read_bytes()
    assert (tmp_path / "a" / "000000.ply").read_bytes() == first
    assert (tmp_path / "b" / "000000.ply").read_bytes() != first


def test_what_is_there_is_never_lost(run, scene_folder, tmp_path):
    scene = open_scene(scene_folder)
    with pytest.raises(ConfigError, match="--resume goes on with it"):
        train(scene, run.folder, SETTINGS)
    with pytest.raises(ConfigError, match="has budget 260, not 261"):
        train(scene, run.folder, replace(SETTINGS, budget=261), resume=True)
    with pytest.raises(ConfigError, match="the run there has cameras"):
        train(replace(scene, frames=tuple(f[:-1] for f in scene.frames)), run.folder, SETTINGS, resume=True)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.txt").write_text("mine")
    with pytest.raises(ConfigError, match="a folder with other files"):
        train(scene, tmp_path / "other", SETTINGS)
    assert (tmp_path / "other" / "thesis.txt").read_text() == "mine"


@pytest.mark.parametrize(("method", "keys"), [("naive3dgs", [0, 1, 2]), ("v3", [0, 2])])
def test_baselines_group_as_they_say(scene_folder, tmp_path, method, keys):
    settings = replace(SETTINGS, method=method, group=2, first_iterations=40)
    model = train(open_scene(scene_folder, frames=(2, 5)), tmp_path / "m", settings)
    assert model.record.keyframes() == keys
    assert all(f.rejected_psnr is None for f in model.record.frames)


def test_exposure_is_found(scene_folder, tmp_path):
    """One camera that is 20 % brighter gets that gain, and pictures of the run are corrected by it."""
    shutil.copytree(scene_folder, tmp_path / "scene")
    for path in (tmp_path / "scene" / "images" / "cam01").glob("*.png"):
        cv2.imwrite(str(path), np.clip(cv2.imread(str(path)) * 1.2, 0, 255).astype(np.uint8))
    settings = replace(SETTINGS, match_exposure=True, first_iterations=500)
    model = train(open_scene(tmp_path / "scene", frames=(0, 2)), tmp_path / "m", settings)
    gains = {name: np.mean(values[:3]) for name, values in model.record.exposure.items()}
    assert gains["cam01"] - np.mean([g for n, g in gains.items() if n != "cam01"]) == pytest.approx(0.2, abs=0.08)
    assert np.mean(list(gains.values())) == pytest.approx(1.0, abs=0.01)


def test_usage_that_is_broken_is_refused(run, tmp_path):
    path = tmp_path / "usage.npz"
    path.write_bytes(b"PK\x03\x04 broken")
    with pytest.raises(SceneError, match=r"usage\.npz: expected usage"):
        load_usage(path, 0, 3)


# ------------------------------------------------------------------ commands

QUICK = ["--iterations", "30,20,8", "--budget", "150", "--sh-degree", "0", "--device", "cpu"]


def test_airgs_train_says_what_it_did_and_reports(scene_folder, tmp_path, capsys):
    words = [str(scene_folder), "-o", str(tmp_path / "m"), "--report", str(tmp_path / "r"), *QUICK, "--frames", "0:2"]
    assert train_main(words) == 0
    out = capsys.readouterr().out
    assert "first frame" in out and "held-out" in out and out.count("\nframe") == 1
    assert {"index.html", "training.png", "frame-000000.png", "frame-000001.png"} <= {
        p.name for p in (tmp_path / "r").iterdir()
    }
    page = (tmp_path / "r" / "index.html").read_text()
    assert "frame-000001.png" in page and "PSNR of held-out views" in page
    assert train_main(words) == 2  # the model is there
    assert "--resume" in capsys.readouterr().err
    assert train_main([*words, "--resume", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["keyframes"] == [0]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nowhere"], "expected multi-view pictures"),
        (["SCENE", "--frames", "3:9"], "frames inside 0:5"),
        (["SCENE", "--frames", "x"], "expected A:B"),
        (["SCENE", "--hold-out", "cam99"], "no camera cam99"),
        (["SCENE", "--iterations", "5"], "expected FIRST,KEY,FRAME"),
        (["SCENE", "--budget", "0"], "budget of at least one"),
        (["SCENE", "--near", "-1"], "expected a positive distance"),
        (["SCENE", "--fps", "0"], "expected 0 < fps"),
        (["SCENE", "--max-size", "3"], "16 pixels"),
        (["SCENE", "--foreground"], "expected a mask"),
    ],
)
def test_bad_input_is_one_line_and_exit_2(scene_folder, tmp_path, capsys, words, message):
    words = [str(scene_folder) if w == "SCENE" else w for w in words]
    assert train_main([*words, "-o", str(tmp_path / "m")]) == 2
    err = capsys.readouterr().err
    assert message in err and err.count("\n") == 1
    assert not list(tmp_path.glob("m/*.ply"))


def test_airgs_encode_trains_multi_view_scenes_first(scene_folder, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("airgs_codec.cli.encode.default_settings", lambda device: replace(SETTINGS, frame_iterations=5))
    shutil.copytree(scene_folder, tmp_path / "blobs")
    words = [str(tmp_path / "blobs"), "--preset", "ultrafast", "--measure-frames", "1"]
    assert encode_main(words) == 0
    assert "first frame" in capsys.readouterr().out
    package = open_package(tmp_path / "blobs.airgs")
    assert package.manifest.frames == 5 and package.manifest.views.source == "given"
    assert package.manifest.attribution == "blobs by nobody"
    assert (tmp_path / "blobs.gaussians" / "usage.npz").is_file()
    assert encode_main([*words, "--json"]) == 0  # the model is there: only encoded
    json.loads(capsys.readouterr().out)
