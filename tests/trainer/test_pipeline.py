"""A run in chunks ends with the same files, whoever has trained them, in whatever order, and however often it died."""

import itertools
import json
import shutil
from dataclasses import replace
from functools import wraps

import numpy as np
import pytest

from airgs_codec.trainer import pipeline
from tests import faces
from tests.faces import Work, open_run, open_scene, open_store, read_model, train, train_in_jobs
from tests.support.training import APPEARS, CHUNKED, files
from tests.support.views import coloured_cloud

SPANS = [(0, 3), (3, 5)]  # of chunks


@pytest.fixture(scope="module", autouse=True)
def small():
    """Threads would wait for each other longer than they work on pictures of this size."""
    with faces.one_thread():
        yield


@pytest.fixture(scope="module")
def scene(blobs):
    return open_scene(blobs)


@pytest.fixture
def expected(small, model_of):
    return files(model_of("chunked") / "m")


@pytest.fixture
def done(monkeypatch):
    """What jobs have fitted: where the chunk of a first frame ends, and the frames of other chunks."""
    found = []

    def counted(fit):
        def call(scene, settings, device, what, *more):
            found.append(what)
            return fit(scene, settings, device, what, *more)

        return wraps(fit)(call)

    for name in ("fit_first", "fit_chunk"):
        monkeypatch.setattr(pipeline, name, counted(getattr(pipeline, name)))
    return found


def train_with(scene, folder, work, settings=CHUNKED, **more):
    return [f.frame for f in train_in_jobs(open_run(scene, folder, settings, **more), work)]


def test_chunks_begin_with_keyframes_which_may_have_half_as_many_gaussians_more_than_the_first_frame(model_of, scene):
    """Or the budget, where that is more, unless the settings say how many."""
    model = read_model(model_of("chunked") / "m")
    assert model.finished() and [f.kind for f in model.record.frames] == [
        "first",
        "frame",
        "frame",
        "keyframe",
        "frame",
    ]
    assert np.mean([gains[:3] for gains in model.record.exposure.values()]) == pytest.approx(1.0, abs=0.01)
    assert model.record.frames[0].gaussians < model.record.frames[-1].gaussians <= CHUNKED.budget
    for budget, capacity, rows, most in (
        (260, None, 118, 260), (260, None, 205, 308), (None, None, 118, 177), (50, 70, 118, 70),
    ):  # fmt: skip
        capture = faces.Capture.of(scene, faces.TrainSettings(budget=budget, capacity=capacity), "cpu")
        first = faces.from_points(np.zeros((rows, 3)), np.zeros((rows, 3)), 0, 0.5, 1.0)
        assert capture.with_first(first, {}).settings.capacity == most


def test_two_processes_write_the_same_files(scene, expected, tmp_path):
    with faces.Processes(2) as executor:
        train_with(scene, tmp_path / "two", Work(executor, open_store(tmp_path / "other")))
    assert files(tmp_path / "two") == expected
    stored = [path for path in (tmp_path / "other").rglob("*") if path.is_file()]
    assert len(stored) == 6 + 1 + 2  # what rests before each camera, the first frame, chunks of frames


def killed_at(frame, iteration):
    """`iteration`: of all fits of the frame, counted from 1."""
    begun = itertools.count(1)

    def progress(what, *_):
        if what.startswith(f"training: frame {frame} ") and next(begun) == iteration:
            raise KeyboardInterrupt

    return progress


def test_a_run_by_one_process_that_is_killed_goes_on_to_the_same_end_in_one_or_in_jobs(scene, expected, tmp_path, done):
    folder = tmp_path / "m"
    for frame, iteration in ((0, 10), (2, 3), (4, 1)):
        with pytest.raises(KeyboardInterrupt):
            train(scene, folder, CHUNKED, resume=True, progress=killed_at(frame, iteration))
        assert len(list(folder.glob("*.ply"))) == frame  # finished frames are there
    copy = shutil.copytree(folder, tmp_path / "copy")
    train(scene, folder, CHUNKED, resume=True)
    train_with(scene, copy, Work(None, open_store(tmp_path / "work")), resume=True)
    assert files(folder) == files(copy) == expected and done == SPANS[1:]


def test_a_run_that_was_cut_off_redoes_only_what_is_missing(scene, expected, tmp_path, monkeypatch, done):
    work, fit = Work(None, open_store(tmp_path / "work")), pipeline.train_chunk

    def stop(capture, frames, *more):
        if frames.start == APPEARS:
            raise KeyboardInterrupt
        return fit(capture, frames, *more)

    monkeypatch.setattr(pipeline, "train_chunk", stop)
    with pytest.raises(KeyboardInterrupt):
        train_with(scene, tmp_path / "m", work)
    assert len(read_model(tmp_path / "m").record.frames) == 1  # the first frame is there for all that go on
    monkeypatch.setattr(pipeline, "train_chunk", fit)
    done.clear()
    train_with(scene, tmp_path / "m", work, resume=True)
    assert done == SPANS[1:] and files(tmp_path / "m") == expected
    assert train_with(scene, tmp_path / "m", work, resume=True) == [] and done == SPANS[1:]


@pytest.mark.parametrize("by_jobs", [False, True])
def test_a_model_that_was_written_in_part_is_finished_by_either(scene, expected, model_of, tmp_path, by_jobs, done):
    made = Work(None, open_store(model_of("chunked") / "work"))
    frames = train_in_jobs(open_run(scene, tmp_path / "m", CHUNKED), made)
    assert [f.frame for f in itertools.islice(frames, 2)] == [0, 1]
    frames.close()
    if by_jobs:
        assert train_with(scene, tmp_path / "m", made, resume=True) == [1, 2, 3, 4] and not done
    else:
        train(scene, tmp_path / "m", CHUNKED, resume=True)
    assert files(tmp_path / "m") == expected


@pytest.mark.parametrize("length", [1, 3])
def test_whoever_writes_the_model_measures_nothing_that_jobs_have(scene, model_of, tmp_path, length):
    """The machine of the command may have no GPU: the usage of all groups comes from jobs, those written before too."""
    settings = replace(CHUNKED, group_frames=length)
    work = Work(None, open_store((model_of("chunked") if settings == CHUNKED else tmp_path) / "work"))

    def train_blindly(**more):
        run = open_run(scene, tmp_path / "m", settings, **more)
        return train_in_jobs(replace(run, capture=replace(run.capture, pictures=None)), work)  # nothing to measure with

    frames = train_blindly()
    assert [f.frame for f in itertools.islice(frames, 4)] == [0, 1, 2, 3]
    frames.close()
    assert [f.frame for f in train_blindly(resume=True)][-1] == 4
    assert read_model(tmp_path / "m").finished()


def test_a_picture_that_changes_is_trained_again_in_its_chunk_alone(blobs, tmp_path, done):
    """Without plates, where nothing is known to rest either."""
    folder = shutil.copytree(blobs, tmp_path / "scene")
    settings = replace(CHUNKED, static="off", deltas="direct", temporal=faces.Temporal(weight=0.0))
    work = Work(None, open_store(tmp_path / "work"))
    train_with(open_scene(folder), tmp_path / "before", work, settings)
    assert done == [1, *SPANS]
    done.clear()
    path = folder / "images" / open_scene(folder).cameras[0].name / "0004.png"
    faces.write_png(path, 255 - faces.read_picture(path))
    train_with(open_scene(folder), tmp_path / "after", work, settings)
    assert done == SPANS[1:]
    before, after = (files(tmp_path / name)[0] for name in ("before", "after"))
    assert before["000004.ply"] != after["000004.ply"]
    assert all(before[f"00000{frame}.ply"] == after[f"00000{frame}.ply"] for frame in range(4))
    first, second = (read_model(tmp_path / "before").read(frame).means for frame in range(2))
    assert (first == second).all(axis=1).mean() < 0.2


class Named(Work):
    """Work that is not done; it stops at chunks of frames, with what names that of the last one."""

    def results(self, stage, function, calls, contents=None, version=0):
        if stage == "training: chunks":
            raise LookupError(faces.content_digest(contents[-1], version))
        if stage == "first frame":
            return [faces.TrainedFrame(*self.store)]
        return super().results(stage, function, calls) if contents is None else [faces.content_digest(contents)]


def test_all_that_a_run_reads_decides_its_files_and_is_in_the_names_of_jobs(scene, expected, tmp_path):
    numbers = itertools.count()

    def names(scene=scene, settings=CHUNKED, device="cpu", shown=1):
        run = open_run(scene, tmp_path / f"{next(numbers)}", settings)
        run = replace(run, capture=replace(run.capture, device=device))
        record = faces.FrameRecord(0, "first", 9, 0, 30.0, None, None, None, None, 1.0)
        with pytest.raises(LookupError) as stopped:
            list(train_in_jobs(run, Named(store=(coloured_cloud(9, seed=shown), record))))
        return str(stopped.value)

    left, shot, *right = scene.frames[3]
    shots = (left, replace(shot, camera=replace(shot.camera, world_to_camera=np.eye(4))), *right)
    others = [
        names(settings=replace(CHUNKED, seed=1)),
        names(settings=replace(CHUNKED, static="off")),
        names(device="cuda"),
        names(shown=2),
        names(replace(scene, points=None)),
        names(replace(scene, frames=(*scene.frames[:3], shots, *scene.frames[4:])), replace(CHUNKED, static="off")),
    ]
    assert len({names(), *others}) == 7
    assert names(settings=replace(CHUNKED, group_frames=2)) == names(settings=replace(CHUNKED, group_frames=1))
    next(faces.train_frames(open_run(scene, tmp_path / "m", replace(CHUNKED, seed=1))))
    assert (tmp_path / "m" / "000000.ply").read_bytes() != expected[0]["000000.ply"]


@pytest.mark.parametrize(("device", "needs"), [("cpu", None), ("cuda", {"GPU": 1})])
def test_a_cluster_that_trains_on_gpus_is_asked_for_them(blobs, tmp_path, capsys, monkeypatch, device, needs):
    def begin(*given):
        raise faces.WorkError(f"asked {given}")

    monkeypatch.setattr("airgs_codec.jobs.executors.DaskCluster", begin)
    words = f"{blobs} -o {tmp_path}/m --sync off --group-frames 2 --executor dask:tcp://farm:1 --device {device}"
    assert faces.airgs_train(words.split()) == 2
    assert f"asked {('tcp://farm:1', 1, needs)}" in capsys.readouterr().err
    assert faces.airgs_train(words.replace("dask:tcp://farm:1", "ray --resume").split()) == 2
    assert "expected dask or dask:ADDRESS, got 'ray'" in capsys.readouterr().err


def test_the_command_trains_in_jobs_and_reports(blobs, tmp_path, capsys):
    words = ["--device", "cpu", "--iterations", "9,4,2", "--budget", "150", "--sh-degree", "0", "--min-psnr", "0"]
    words += ["--max-drop", "99", "--frames", "0:4", "--group-frames", "2", "--work", str(tmp_path / "work")]
    words += ["--report", str(tmp_path / "r"), "-o", str(tmp_path / "m"), "--json"]
    assert faces.airgs_train([str(blobs), *words]) == 0
    assert json.loads(capsys.readouterr().out)["keyframes"] == [0, 2]
    assert "image/svg" in (tmp_path / "r" / "index.html").read_text()
