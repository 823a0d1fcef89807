"""A package is the same to the byte, whoever has done its jobs, in whatever order, and however often it was cut off.

The steps of which jobs are made are declared once, and frames are read once where memory holds them.
"""

import inspect
import itertools
import pickle
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from airgs_codec.encoder.pipeline import KEY, STEPS, SURVEY, Step, with_rows_of_others

from airgs_codec.jobs import work as work_module
from tests import faces
from tests.faces import EncodeSettings, ViewPlan, Work, airgs_encode, encode, open_sequence, open_store, validate
from tests.support.jobs import prepared_as_one_group
from tests.support.mutations import read_files
from tests.support.packages import SEEN
from tests.support.scenes import moving_frames, random_gaussians, write_sequence

QUICK = {"measure_pictures": 1, "decide_pictures": 4, "preset": "ultrafast", "threads": 1}
SETTINGS = EncodeSettings(calibrate="steps", group_frames=4, **QUICK)
GIVEN = """sequence span views settings fps renderer coded base first_segment tables pictures base_files frame camera
    row_error"""


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """Twelve frames: four of one thing, and eight of another, which rests, so that its last four keep rows."""
    other = random_gaussians(120, seed=9)
    other = replace(other, means=3 + 2 * other.means)
    return write_sequence(tmp_path_factory.mktemp("parts") / "scene", [*moving_frames(120, 4), *[other] * 8])


@pytest.fixture(scope="module")
def expected(scene, made_once):
    """The files of the package as one process makes it."""

    def make(folder):
        report = encode(scene, folder, SETTINGS)
        assert [group.keeps for group in report.manifest.groups] == [None, None, 2]
        assert not validate(folder)
        kinds = Counter(record.kind for record in report.records)
        assert {kind: kinds[kind] for kind in ("survey", "keys", "states")} == {"survey": 3, "keys": 2, "states": 3}

    return read_files(made_once("parts.airgs", make))


def test_processes_write_the_same_bytes(scene, expected, tmp_path):
    """The command shares the work among them and reports it."""
    words = f"-o {tmp_path}/out --work {tmp_path}/work --report {tmp_path}/report --jobs 2 --calibrate steps"
    words += " --group-frames 4 --measure-pictures 1 --decide-pictures 4 --x264-preset ultrafast"
    assert airgs_encode([str(scene), *words.split()]) == 0
    assert read_files(tmp_path / "out") == expected
    assert "<svg" in (tmp_path / "report" / "index.html").read_text()


def test_an_object_store_holds_the_work_and_threads_change_nothing(scene, expected, bucket, tmp_path):
    store = open_store(f"{bucket}/work")
    work = Work(pickle.loads(pickle.dumps(store)))
    encode(scene, tmp_path / "out", replace(SETTINGS, threads=4), work=work)
    assert read_files(tmp_path / "out") == expected
    store.write("ab", b"1")
    store.place.write("ab/ab", b"damaged")
    assert store.read("ab") is None and not store.has("ab")


def test_a_run_that_was_cut_off_redoes_only_what_is_missing(scene, expected, tmp_path, monkeypatch):
    store, done, again, perform = open_store(tmp_path / "work"), [], [], work_module.perform

    def some(where, job):
        if len(done) == 7:
            raise KeyboardInterrupt
        done.append(job.entry)
        return perform(where, job)

    monkeypatch.setattr(work_module, "perform", some)
    with pytest.raises(KeyboardInterrupt):
        encode(scene, tmp_path / "out", SETTINGS, work=Work(store))
    assert not (tmp_path / "out").exists()
    monkeypatch.setattr(work_module, "perform", lambda where, job: again.append(job.entry) or perform(where, job))
    encode(scene, tmp_path / "out", SETTINGS, work=Work(store))
    assert read_files(tmp_path / "out") == expected
    assert again and not set(done) & set(again)
    again.clear()
    encode(scene, tmp_path / "out", SETTINGS, work=Work(store))
    assert again == []


def test_one_frame_that_changes_is_the_only_group_that_is_made_again(tmp_path, monkeypatch):
    frames, done, perform = moving_frames(120, 8), [], work_module.perform
    folder, store = write_sequence(tmp_path / "scene", frames), open_store(tmp_path / "work")
    settings = replace(SETTINGS, calibrate="none", keys="apart")
    encode(folder, tmp_path / "out", settings, work=Work(store))
    faces.write_ply(sorted(folder.glob("*.ply"))[6], frames[2])
    monkeypatch.setattr(work_module, "perform", lambda where, job: done.append(job.label) or perform(where, job))
    encode(folder, tmp_path / "out", settings, work=Work(store))
    assert set(done) == {"frames 4-7"}


@pytest.mark.parametrize(("words", "expected"), [
    ("--jobs 0", "--jobs: expected at least one"),
    ("--executor ray", "--executor: expected dask or dask:ADDRESS, got 'ray'"),
    ("--executor dask:tcp://h:1", "expected --work, a place that all workers see"),
])  # fmt: skip
def test_options_that_cannot_work_are_one_line(scene, tmp_path, capsys, words, expected):
    assert airgs_encode([str(scene), "-o", str(tmp_path / "out"), *words.split()]) == 2
    assert expected in capsys.readouterr().err and not (tmp_path / "out").exists()


def test_frames_are_read_once_where_memory_holds_all_and_else_three_times(tmp_path, monkeypatch):
    """To be named, surveyed, and encoded and measured; the first ones and the middle one are looked at before.

    The first one is that as well when the sequence is opened. There are no cameras, so that views are looked for.
    """
    reads, read, out = Counter(), faces.read_frame, tmp_path / "out"
    monkeypatch.setattr("airgs_codec.scene.formats.table.read_frame", lambda p: reads.update([p.stem]) or read(p))
    scene = write_sequence(tmp_path / "scene", moving_frames(150, 6), cameras=False)
    settings = replace(SETTINGS, group_frames=2)
    encode(scene, out, settings)
    assert reads == {f"{number:06d}": 1 + (number == 0) for number in range(6)}  # the first for the origin as well
    settings = replace(settings, calibrate="none", region=SEEN)
    encode(scene, tmp_path / "held", settings)
    reads.clear()
    monkeypatch.setattr("airgs_codec.encoder.prepare.held_bytes", lambda: 2 * 150 * 4 * 14)  # one group of two frames
    encode(scene, out, settings)
    looked = {"000000": 2, "000001": 1, "000002": 1, "000003": 1}
    assert len(reads) == 6 and all(count <= 3 + looked.get(name, 0) for name, count in reads.items())
    assert read_files(out) == read_files(tmp_path / "held")


def test_frames_are_held_up_to_so_many_bytes_and_by_one_process():
    frames, asked = [random_gaussians(10, seed=seed) for seed in range(3)], []
    held = faces.HeldFrames(2 * 10 * 4 * 14)  # two of them
    for number in (0, 1, 0, 2, 0, 1):
        assert held.get(number, lambda t: asked.append(t) or frames[t]) is frames[number]
    assert asked == [0, 1, 2, 1]
    assert [number in held for number in range(3)] == [True, True, False]
    copy = pickle.loads(pickle.dumps(held))
    copy.get(0, frames.__getitem__)
    assert 0 not in copy
    held.clear()
    assert 0 not in held


def test_steps_and_jobs_read_what_is_given_or_made_by_steps_before_them(scene, tmp_path):
    for step in STEPS.values():
        assert set(step.reads) <= set(GIVEN.split()) | set(STEPS), step.name
        assert len(inspect.signature(step.function).parameters) == len(step.reads), step.name
    known = {"a": 2, "b": 5}
    assert Step("sum", lambda a, b: a + b, ("a", "b"), "c").do(known) == 7 and known["c"] == 7
    sequence = open_sequence(scene)
    prepared = prepared_as_one_group(sequence, ViewPlan.of(sequence, 4), Work(open_store(tmp_path)))
    survey, key = prepared.job(SURVEY, 0), prepared.job(KEY, 0, SETTINGS)
    assert faces.Stored(survey.entry) in key.arguments
    assert prepared.job(KEY, 0, EncodeSettings(threads=7)).entry == prepared.job(KEY, 0, EncodeSettings()).entry
    assert key.entry != prepared.job(KEY, 0, EncodeSettings()).entry


def test_a_key_has_rows_of_other_groups_up_to_a_quarter_more_and_of_so_many_groups():
    own, few, many = np.arange(8), np.array([7, 8]), np.array([8, 9, 10])
    for groups, count, joined in (([own, few, own, np.array([9]), many, few], 10, 4), ([own, many, few], 8, 1)):
        rows, found = with_rows_of_others(groups)
        assert (rows.tolist(), found) == ([*range(count)], joined)
    assert with_rows_of_others(itertools.repeat(own))[1] == 16
