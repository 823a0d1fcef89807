"""A package is the same to the byte, whoever has done its jobs, in whatever order, and however often it was cut off."""

import pickle
from dataclasses import replace

import pytest

from airgs_codec.jobs import work as work_module
from tests.faces import (
    EncodeSettings,
    Processes,
    Work,
    airgs_encode,
    encode,
    open_sequence,
    open_store,
    validate,
    write_ply,
)
from tests.support.mutations import read_files
from tests.support.scenes import moving_frames, random_gaussians, write_sequence

SETTINGS = EncodeSettings(
    calibrate="steps", measure_pictures=1, decide_pictures=4, preset="ultrafast", group_frames=4, threads=1
)


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """Twelve frames: four of one thing, and eight of another, which rests, so that its last four keep rows."""
    frames = moving_frames(120, 4)
    other = random_gaussians(120, seed=9)
    other = replace(other, means=3 + 2 * other.means)
    return write_sequence(tmp_path_factory.mktemp("parts") / "scene", [*frames, *[other] * 8])


@pytest.fixture(scope="module")
def expected(scene, tmp_path_factory):
    """The files of the package as one process makes it."""
    folder = tmp_path_factory.mktemp("whole") / "scene.airgs"
    m = encode(open_sequence(scene), folder, SETTINGS).manifest
    assert [group.keeps for group in m.groups] == [None, None, 2]
    assert not validate(folder)
    return read_files(folder)


def test_processes_write_the_same_bytes(scene, expected, tmp_path):
    engine = Processes(2)
    try:
        work = Work(open_store(tmp_path / "work"), engine)
        report = encode(open_sequence(scene), tmp_path / "out", SETTINGS, work=work)
    finally:
        engine.close()
    assert read_files(tmp_path / "out") == expected
    kinds = [record.kind for record in report.records]
    assert {kind: kinds.count(kind) for kind in ("survey", "keys", "states")} == {"survey": 3, "keys": 2, "states": 3}


def test_an_object_store_holds_the_work(scene, expected, bucket, tmp_path):
    store = open_store(f"{bucket}/work")
    encode(open_sequence(scene), tmp_path / "out", SETTINGS, work=Work(pickle.loads(pickle.dumps(store))))
    assert read_files(tmp_path / "out") == expected
    store.write("ab", b"1")
    store.place.write("ab/ab", b"damaged")
    assert store.read("ab") is None and not store.has("ab")


def test_a_run_that_was_cut_off_redoes_only_what_is_missing(scene, expected, tmp_path, monkeypatch):
    store, done = open_store(tmp_path / "work"), []
    perform = work_module.perform

    def some(where, job):
        if len(done) == 7:
            raise KeyboardInterrupt
        done.append(job.entry)
        return perform(where, job)

    monkeypatch.setattr(work_module, "perform", some)
    with pytest.raises(KeyboardInterrupt):
        encode(open_sequence(scene), tmp_path / "out", SETTINGS, work=Work(store))
    assert not (tmp_path / "out").exists()
    again = []
    monkeypatch.setattr(work_module, "perform", lambda where, job: again.append(job.entry) or perform(where, job))
    encode(open_sequence(scene), tmp_path / "out", SETTINGS, work=Work(store))
    assert read_files(tmp_path / "out") == expected
    assert again and not set(done) & set(again)
    again.clear()
    encode(open_sequence(scene), tmp_path / "out", SETTINGS, work=Work(store))
    assert again == []


def test_one_frame_that_changes_is_the_only_group_that_is_made_again(scene, tmp_path, monkeypatch):
    frames = moving_frames(120, 8)
    folder = write_sequence(tmp_path / "scene", frames)
    settings, store, done = EncodeSettings(**PLAIN, keys="apart"), open_store(tmp_path / "work"), []
    encode(open_sequence(folder), tmp_path / "out", settings, work=Work(store))
    write_ply(sorted(folder.glob("*.ply"))[6], frames[2])
    perform = work_module.perform
    monkeypatch.setattr(work_module, "perform", lambda where, job: done.append(job.label) or perform(where, job))
    encode(open_sequence(folder), tmp_path / "out", settings, work=Work(store))
    assert set(done) == {"frames 4-7"}


PLAIN = {
    "calibrate": "none", "measure_pictures": 1, "decide_pictures": 4, "preset": "ultrafast", "group_frames": 4,
}  # fmt: skip


def test_the_command_shares_the_work_and_reports_it(scene, tmp_path):
    words = [str(scene), "--preset", "quick", "--group-frames", "4", "--x264-preset", "ultrafast"]
    shared = ["--jobs", "2", "--work", str(tmp_path / "work"), "--report", str(tmp_path / "report")]
    assert airgs_encode([*words, "-o", str(tmp_path / "shared"), *shared]) == 0
    assert "<svg" in (tmp_path / "report" / "index.html").read_text()
    assert airgs_encode([*words, "-o", str(tmp_path / "out")]) == 0
    assert read_files(tmp_path / "shared") == read_files(tmp_path / "out")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--jobs", "0"], "--jobs: expected at least one"),
        (["--executor", "ray"], "--executor: expected dask or dask:ADDRESS, got 'ray'"),
        (["--executor", "dask:tcp://h:1"], "expected --work, a place that all workers see"),
    ],
)
def test_options_that_cannot_work_are_one_line(scene, tmp_path, capsys, words, expected):
    assert airgs_encode([str(scene), "-o", str(tmp_path / "out"), *words]) == 2
    assert expected in capsys.readouterr().err and not (tmp_path / "out").exists()
