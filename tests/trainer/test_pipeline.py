"""A run in chunks ends with the same files, whoever has trained them, in whatever order, and however often it died."""

import json
import shutil
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from dask.distributed import LocalCluster

from airgs_codec.jobs import dask_engine
from airgs_codec.jobs import work as work_module
from airgs_codec.jobs.dask_engine import DaskEngine
from airgs_codec.render.cpu import one_thread
from airgs_codec.trainer import pipeline
from airgs_codec.trainer.pipeline import Farm, train_in_jobs
from tests.faces import (
    Capture,
    Job,
    Processes,
    Work,
    WorkError,
    airgs_train,
    open_run,
    open_scene,
    open_store,
    read_model,
    read_picture,
    train,
    write_png,
)
from tests.support.jobs import square
from tests.support.training import SETTINGS
from tests.trainer.test_record import StopError, files, killed_at

CHUNKED = replace(
    SETTINGS, group_frames=2, first_iterations=20, key_iterations=10, frame_iterations=4, match_exposure="on"
)
SPANS = ["frames 0-1", "frames 2-3"]


@pytest.fixture(scope="module", autouse=True)
def small():
    """Threads would wait for each other longer than they work on pictures of this size."""
    with one_thread():
        yield


@pytest.fixture(scope="module")
def scene(blobs):
    return open_scene(blobs, frames=(0, 4))


@pytest.fixture(scope="module")
def compiled():
    """Other processes have compiled the kernels: what one compiles may differ in the last bits from what it loads."""
    subprocess.run([sys.executable, "-m", "airgs_codec.cli.kernels"], check=True)


@pytest.fixture(scope="module")
def expected(scene, compiled, tmp_path_factory):
    """What one process leaves that trains frame after frame."""
    model = train(scene, tmp_path_factory.mktemp("models") / "chunked", CHUNKED)
    assert [f.kind for f in model.record.frames][::2] == ["first", "key"]
    assert model.record.exposure and model.finished()
    return files(model.folder)


@pytest.fixture(scope="module")
def made(scene, compiled, tmp_path_factory):
    """A model folder, and the work that one process has trained it with."""
    folder = tmp_path_factory.mktemp("jobs")
    work = Work(open_store(folder / "work"))
    assert train_with(scene, folder / "m", work) == [0, 1, 2, 3]
    return folder / "m", work


@pytest.fixture
def done(monkeypatch):
    """Labels of the jobs that are done in this process."""
    labels, perform = [], work_module.perform
    monkeypatch.setattr(work_module, "perform", lambda store, job: labels.append(job.label) or perform(store, job))
    return labels


def train_with(scene, folder, work, settings=CHUNKED, **more):
    return [f.frame for f in train_in_jobs(open_run(scene, folder, settings, **more), work)]


def test_jobs_of_one_process_and_of_two_write_the_same_files(scene, expected, made, tmp_path):
    assert files(made[0]) == expected
    engine = Processes(2)
    try:
        work = Work(open_store(tmp_path / "other"), engine)
        train_with(scene, tmp_path / "two", work)
    finally:
        engine.close()
    assert files(tmp_path / "two") == expected
    kinds = [record.kind for record in work.records()]
    assert {k: kinds.count(k) for k in kinds} == {"what rests": 6, "first frame": 1, "chunks of frames": 2}


def test_networks_of_a_chunk_are_those_of_one_process(scene, tmp_path):
    settings, scene = replace(CHUNKED, deltas="mlp", group_frames=3), replace(scene, frames=scene.frames[:3])
    train(scene, tmp_path / "whole", settings)
    train_with(scene, tmp_path / "jobs", Work(open_store(tmp_path / "work")), settings)
    assert files(tmp_path / "jobs") == files(tmp_path / "whole")


def test_a_run_that_was_cut_off_redoes_only_what_is_missing(scene, expected, tmp_path, monkeypatch, done):
    work, fit = Work(open_store(tmp_path / "work")), pipeline.train_chunk

    def stop(capture, frames, *more):
        if frames.start == 2:
            raise StopError
        return fit(capture, frames, *more)

    monkeypatch.setattr(pipeline, "train_chunk", stop)
    with pytest.raises(StopError):
        train_with(scene, tmp_path / "m", work)
    assert len(read_model(tmp_path / "m").record.frames) == 1  # the first frame is there for all that go on
    monkeypatch.setattr(pipeline, "train_chunk", fit)
    done.clear()
    train_with(scene, tmp_path / "m", work, resume=True)
    assert done == SPANS[1:] and files(tmp_path / "m") == expected
    assert train_with(scene, tmp_path / "m", work, resume=True) == [] and done == SPANS[1:]


def test_jobs_go_on_where_one_process_ended(scene, expected, tmp_path, done):
    with pytest.raises(StopError):
        train(scene, tmp_path / "m", CHUNKED, progress=killed_at(3, 2))
    train_with(scene, tmp_path / "m", Work(open_store(tmp_path / "work")), resume=True)
    assert files(tmp_path / "m") == expected
    assert [label for label in done if label.startswith("frame")] == SPANS[1:]


@pytest.mark.parametrize("by_jobs", [False, True])
def test_a_model_that_was_written_in_part_is_finished_by_either(scene, expected, made, tmp_path, by_jobs, done):
    frames = train_in_jobs(open_run(scene, tmp_path / "m", CHUNKED), made[1])
    assert [next(frames).frame for _ in range(3)] == [0, 1, 2]
    frames.close()
    if by_jobs:
        assert train_with(scene, tmp_path / "m", made[1], resume=True) == [2, 3] and not done
    else:
        train(scene, tmp_path / "m", CHUNKED, resume=True)
    assert files(tmp_path / "m") == expected


@pytest.mark.parametrize("length", [1, 2])
def test_whoever_writes_the_model_measures_nothing_that_jobs_have(scene, tmp_path, length):
    """The machine of the command may have no GPU: the usage of all groups comes from jobs, those written before too."""
    settings, work = replace(CHUNKED, group_frames=length), Work(open_store(tmp_path / "work"))

    def train_blindly(**more):
        run = open_run(scene, tmp_path / "m", settings, **more)
        return train_in_jobs(replace(run, capture=replace(run.capture, pictures=None)), work)  # nothing to measure with

    frames = train_blindly()
    assert [next(frames).frame for _ in range(3)] == [0, 1, 2]
    frames.close()
    assert [f.frame for f in train_blindly(resume=True)][-1] == 3
    assert read_model(tmp_path / "m").finished()


def test_a_picture_that_changes_is_trained_again_in_its_chunk_alone(blobs, tmp_path, done):
    folder = shutil.copytree(blobs, tmp_path / "scene")
    settings, work = replace(CHUNKED, static="off"), Work(open_store(tmp_path / "work"))
    train_with(open_scene(folder, frames=(0, 4)), tmp_path / "before", work, settings)
    assert done == ["frame 0", *SPANS]
    done.clear()
    path = folder / "images" / open_scene(folder).cameras[0].name / "0003.png"
    write_png(path, 255 - read_picture(path))
    train_with(open_scene(folder, frames=(0, 4)), tmp_path / "after", work, settings)
    assert done == SPANS[1:]
    before, after = (files(tmp_path / name)[0] for name in ("before", "after"))
    assert before["000003.ply"] != after["000003.ply"]
    assert all(before[f"00000{frame}.ply"] == after[f"00000{frame}.ply"] for frame in range(3))


def test_all_that_a_chunk_reads_is_in_its_name(scene, tmp_path):
    work = Work(open_store(tmp_path / "work"))
    first = work.put(1)

    def names(scene=scene, settings=CHUNKED, device="cpu", first=first):
        farm = Farm.of(Capture.of(scene, settings, device), work)
        return farm.chunk_job((2, 4), first, *(job.result for job in farm.rest_jobs())).entry

    moved = replace(scene.frames[2][1].camera, world_to_camera=np.eye(4))
    shots = (scene.frames[2][0], replace(scene.frames[2][1], camera=moved), *scene.frames[2][2:])
    others = [
        names(settings=replace(CHUNKED, seed=1)),
        names(settings=replace(CHUNKED, static="off")),
        names(device="cuda"),
        names(first=work.put(2)),
        names(replace(scene, points=None)),
        names(replace(scene, frames=(*scene.frames[:2], shots, *scene.frames[3:])), replace(CHUNKED, static="off")),
    ]
    assert len({names(), *others}) == 7
    assert names(settings=replace(CHUNKED, group_frames=3)) == names()


def test_a_cluster_gives_jobs_to_workers_that_have_what_they_need(scene, expected, tmp_path, monkeypatch):
    monkeypatch.setattr(dask_engine, "WORKER_S", 0.5)
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None, resources={"GPU": 1}) as cluster:
        engine = DaskEngine.at(cluster.scheduler_address)
        try:
            work = Work(open_store(tmp_path / "work"), engine)
            monkeypatch.setattr(Farm, "needs", {"GPU": 1})
            train_with(scene, tmp_path / "m", work)
            assert files(tmp_path / "m") == expected
            job = Job("square", "", "a" * 64, square, (3, str(tmp_path)), needs={"FPGA": 1})
            with pytest.raises(WorkError, match="a worker started with --resources 'FPGA=1', got 1 without"):
                work.run([job])
        finally:
            engine.close()


def test_a_job_on_a_gpu_says_so(scene, tmp_path):
    work = Work(open_store(tmp_path / "work"))
    cpu, cuda = (Farm.of(Capture.of(scene, CHUNKED, device), work) for device in ("cpu", "cuda"))
    assert cuda.first_job().needs == {"GPU": 1} and not cpu.first_job().needs
    assert cuda.rest_jobs() and not any(job.needs for job in cuda.rest_jobs())


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--jobs", "2"], "--jobs: expected --group-frames"),
        (["--work", "somewhere"], "--work: expected --group-frames"),
        (["--executor", "dask"], "--executor: expected --group-frames"),
        (["--group-frames", "0"], "chunks of at least one frame"),
        (["--group-frames", "2", "--executor", "ray"], "expected dask or dask:ADDRESS"),
    ],
)
def test_options_that_cannot_work_are_one_line_and_exit_2(blobs, tmp_path, capsys, words, message):
    assert airgs_train([str(blobs), "-o", str(tmp_path / "m"), "--device", "cpu", *words]) == 2
    err = capsys.readouterr().err
    assert message in err and err.count("\n") == 1
    assert not list(tmp_path.glob("m/*.ply"))


def test_the_command_trains_in_jobs_and_reports(blobs, tmp_path, capsys):
    words = [str(blobs), "--device", "cpu", "--iterations", "9,4,2", "--budget", "150", "--sh-degree", "0"]
    words += ["--min-psnr", "0", "--max-drop", "99", "--frames", "0:4"]
    words += ["--group-frames", "2", "--work", str(tmp_path / "work"), "--report", str(tmp_path / "r")]
    assert airgs_train([*words, "-o", str(tmp_path / "m"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["keyframes"] == [0, 2]
    assert "<svg" in (tmp_path / "r" / "index.html").read_text()
