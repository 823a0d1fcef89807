"""A package is the same to the byte, whoever encodes its runs, and however often the work was cut off.

What is stored is found again, what is damaged is made again, and frames are read once where memory holds them.
"""

import pickle
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import wraps

import pytest

from airgs_codec.encoder import publish
from tests import faces
from tests.faces import EncodeSettings, Plan, airgs_encode, encode, validate
from tests.support.mutations import read_files
from tests.support.packages import SEEN
from tests.support.scenes import moving_frames, random_gaussians, write_sequence

QUICK = {"measure_pictures": 1, "decide_pictures": 4, "preset": "ultrafast", "threads": 1}
SETTINGS = EncodeSettings(calibrate="steps", group_frames=4, **QUICK)


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
        assert [group.base for group in report.manifest.groups] == [None, None, 2]
        assert report.plan.groups == ((0, 4), (4, 8), (8, 12)) and report.plan.begins == (0, 1)
        assert not validate(folder)

    return read_files(made_once("parts.airgs", make))


@pytest.fixture
def done(monkeypatch):
    """The numbers of the groups that this process encodes as runs from now on."""
    numbers, encode_run = [], publish.encode_run

    @wraps(encode_run)
    def run(frames, plan):
        numbers.append([part.number for part in frames])
        return encode_run(frames, plan)

    monkeypatch.setattr(publish, "encode_run", run)
    return numbers


def test_processes_write_the_same_bytes(scene, expected, tmp_path):
    """The command shares the work among them and reports it."""
    words = f"-o {tmp_path}/out --work {tmp_path}/work --report {tmp_path}/report --jobs 2 --calibrate steps"
    words += " --group-frames 4 --measure-pictures 1 --decide-pictures 4 --x264-preset ultrafast"
    assert airgs_encode([str(scene), *words.split()]) == 0
    assert read_files(tmp_path / "out") == expected
    assert "image/svg+xml" in (tmp_path / "report" / "index.html").read_text()


def test_a_plan_that_was_written_gives_the_same_bytes_by_any_executor_with_any_threads(scene, expected, tmp_path):
    plan = faces.decide(str(scene), SETTINGS)
    read = Plan.from_json(plan.to_json().encode())
    assert read == plan
    with ThreadPoolExecutor(2) as executor:
        many = replace(read, settings=replace(read.settings, threads=4))
        encode(scene, tmp_path / "out", plan=many, executor=executor)
    assert read_files(tmp_path / "out") == expected


def test_a_run_that_was_cut_off_redoes_only_what_is_missing_or_damaged(scene, expected, tmp_path, done, monkeypatch):
    def cut_off(run, plan, encode_run=publish.encode_run):
        if run[0].number:
            raise KeyboardInterrupt
        return encode_run(run, plan)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(publish, "encode_run", wraps(publish.encode_run)(cut_off))
        encode(scene, tmp_path / "out", SETTINGS, work=tmp_path / "work")
    assert done == [[0]] and not (tmp_path / "out").exists()
    (stored,) = (path for path in (tmp_path / "work").rglob("*") if path.is_file())
    for damage, again in ((None, [[1, 2]]), (b"damaged", [[0]]), (None, [])):
        done.clear()
        if damage:
            stored.write_bytes(damage)
        encode(scene, tmp_path / "out", SETTINGS, work=tmp_path / "work")
        assert done == again and read_files(tmp_path / "out") == expected


def test_an_object_store_holds_the_work(scene, expected, bucket, tmp_path, done):
    for again in ([[0], [1, 2]], []):
        done.clear()
        encode(scene, tmp_path / "out", SETTINGS, work=f"{bucket}/work")
        assert done == again and read_files(tmp_path / "out") == expected


def test_one_frame_that_changes_is_the_only_run_that_is_made_again(tmp_path, done):
    frames = moving_frames(120, 8)
    folder = write_sequence(tmp_path / "scene", frames)
    settings = replace(SETTINGS, calibrate="none", keyframes="intra")
    for again in ([[0], [1]], [[1]]):
        done.clear()
        encode(folder, tmp_path / "out", settings, work=tmp_path / "work")
        assert done == again
        faces.write_ply(sorted(folder.glob("*.ply"))[6], frames[2])


def test_frames_are_read_once_where_memory_holds_all_and_else_four_times(tmp_path, monkeypatch):
    """To be put in order, surveyed, encoded and measured; the first and the middle one are looked at before.

    The first one tells the origin when the sequence is opened. There are no cameras, so that views are looked for.
    """
    reads, read, out = Counter(), faces.read_frame, tmp_path / "out"
    monkeypatch.setattr("airgs_codec.scene.formats.table.read_frame", lambda p: reads.update([p.stem]) or read(p))
    scene = write_sequence(tmp_path / "scene", moving_frames(150, 6), cameras=False)
    settings = replace(SETTINGS, group_frames=2)
    encode(scene, out, settings)
    assert reads == {f"{number:06d}": 1 + (number == 0) for number in range(6)}
    settings = replace(settings, calibrate="none", region=SEEN)
    encode(scene, tmp_path / "held", settings)
    reads.clear()
    few = faces.HeldFrames(2 * 150 * 4 * 14)  # one group of two frames
    monkeypatch.setattr(publish, "hold_frames", lambda sequence: replace(sequence, held=few))
    encode(scene, out, settings)
    assert all(count <= 4 + (name in ("000000", "000003")) for name, count in reads.items()) and len(reads) == 6
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
