"""The steps of encoding are declared once, and frames are read once where memory holds them."""

import inspect
import itertools
import pickle
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.analysis.rows import LOOKED_FRAMES
from airgs_codec.encoder import prepare
from airgs_codec.encoder.pipeline import AHEAD, KEY, STEPS, SURVEY, Step, with_rows_of_others
from airgs_codec.jobs.job import Stored
from airgs_codec.scene import sequence as module
from airgs_codec.scene.frames import HeldFrames
from tests.faces import EncodeSettings, ViewPlan, encode, open_sequence, temporary_work
from tests.support.jobs import prepared_as_one_group
from tests.support.mutations import read_files
from tests.support.regions import place, region
from tests.support.scenes import moving_frames, random_gaussians, write_sequence

SETTINGS = EncodeSettings(
    calibrate="steps", measure_pictures=1, decide_pictures=4, preset="ultrafast", group_frames=2, threads=1
)
GIVEN = {
    "sequence", "span", "views", "settings", "fps", "renderer", "coded", "base", "first_segment", "tables", "pictures",
    "base_files", "frame", "camera", "row_error",
}  # fmt: skip


@pytest.fixture
def reads(monkeypatch):
    """How often the file of each frame is read."""
    counts = Counter()
    read = module.read_frame

    def counted(path):
        counts[path.name] += 1
        return read(path)

    monkeypatch.setattr(module, "read_frame", counted)
    return counts


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """Six frames without cameras, so that views are looked for in some of them."""
    return write_sequence(tmp_path_factory.mktemp("pipeline") / "scene", moving_frames(150, 6))


def test_every_frame_is_read_once_where_memory_holds_all(scene, tmp_path, reads):
    encode(open_sequence(scene), tmp_path / "out", SETTINGS)
    assert reads == {f"{number:06d}.ply": 1 + (number == 0) for number in range(6)}  # the first for the origin as well


def test_frames_that_memory_does_not_hold_are_read_three_times(scene, tmp_path, reads, monkeypatch):
    """To be named, surveyed, and encoded and measured; the first ones and the middle one are looked at before.

    The first one is that as well when the sequence is opened.
    """
    settings = replace(SETTINGS, calibrate="none", region=replace(region(place(0.0)), width=96, height=72))
    encode(open_sequence(scene), tmp_path / "held", settings)
    assert sum(reads.values()) == 7
    reads.clear()
    monkeypatch.setattr(prepare, "held_bytes", lambda: 2 * 150 * 4 * 14)  # one group of two frames
    encode(open_sequence(scene), tmp_path / "out", settings)
    looked = {f"{number:06d}.ply": 1 for number in (*range(LOOKED_FRAMES), 3)} | {"000000.ply": 2}
    assert len(reads) == 6 and all(count <= 3 + looked.get(name, 0) for name, count in reads.items())
    assert read_files(tmp_path / "out") == read_files(tmp_path / "held")


def test_frames_are_held_up_to_so_many_bytes_and_by_one_process():
    frames = [random_gaussians(10, seed=seed) for seed in range(3)]
    asked = []

    def read(number):
        asked.append(number)
        return frames[number]

    held = HeldFrames(2 * 10 * 4 * 14)  # two of them
    for number in (0, 1, 0, 2, 0, 1):
        assert held.get(number, read) is frames[number]
    assert asked == [0, 1, 2, 1]
    assert 0 in held and 1 in held and 2 not in held
    copy = pickle.loads(pickle.dumps(held))
    copy.get(0, read)
    assert 0 not in copy
    held.clear()
    assert 0 not in held


@pytest.mark.parametrize("step", STEPS.values(), ids=lambda step: step.name)
def test_a_step_reads_what_is_given_or_made_by_another(step):
    assert set(step.reads) <= GIVEN | set(STEPS)
    assert len(inspect.signature(step.function).parameters) == len(step.reads)


def test_a_job_reads_the_results_of_the_steps_before_it(scene):
    sequence = open_sequence(scene)
    with temporary_work() as work:
        prepared = prepared_as_one_group(sequence, ViewPlan.of(sequence, 4), work)
    survey, key = prepared.job(SURVEY, 0), prepared.job(KEY, 0, SETTINGS)
    assert Stored(survey.entry) in key.arguments
    assert prepared.job(KEY, 0, EncodeSettings(threads=7)).entry == prepared.job(KEY, 0, EncodeSettings()).entry
    assert key.entry != prepared.job(KEY, 0, EncodeSettings()).entry


def test_a_step_that_is_taken_at_once_makes_its_value_known():
    known = {"a": 2, "b": 5}
    step = Step("sum", lambda a, b: a + b, ("a", "b"), "c")
    assert step.do(known) == 7 and known["c"] == 7


def test_a_key_has_rows_of_other_groups_up_to_a_quarter_more_and_of_so_many_groups():
    own, few, many = np.arange(8), np.array([7, 8]), np.array([8, 9, 10])
    rows, groups = with_rows_of_others([own, few, own, np.array([9]), many, few])
    assert rows.tolist() == [*range(10)] and groups == 4
    rows, groups = with_rows_of_others([own, many, few])
    assert rows.tolist() == own.tolist() and groups == 1
    assert with_rows_of_others(itertools.repeat(own))[1] == AHEAD
