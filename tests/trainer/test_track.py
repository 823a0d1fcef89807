"""Tracking: frames that know nothing of each other take fewer bytes, and show what they have in common."""

import json
import pickle
import shutil
from concurrent.futures import Executor, Future
from dataclasses import replace

import numpy as np
import pytest

import airgs_codec as airgs
from airgs_codec.analysis.flow import carry
from airgs_codec.trainer import track
from tests import faces
from tests.faces import CPU, EncodeSettings, GaussianSequence, Work, as_fast, encode, open_package, render
from tests.support.mutations import read_files
from tests.support.paths import FOX_VIEWS
from tests.support.scenes import predicted, random_gaussians, write_sequence
from tests.support.training import files

SETTINGS = as_fast(EncodeSettings(threads=1, device="cpu"))


def encode_tracked(given, path, executor=None, folder=None):
    with faces.tracked(given, CPU, Work(executor), folder) as moving:
        encode(moving, path, SETTINGS)


def turned(g, angle):
    q = faces.from_rotation_vector(np.array([0.0, angle, 0.0]))
    means = g.means @ faces.to_matrices(q).T + [angle, 0, 0]
    quaternions = faces.multiply(q, g.quaternions.astype(np.float64))
    return replace(g, means=means.astype(np.float32), quaternions=quaternions.astype(np.float32))


def mse(a, b):
    return float(np.mean([(render(a, view).rgb - render(b, view).rgb) ** 2 for view in faces.orbit_views(b, 5, 96)]))


def apart(frames):
    return [predicted(g, np.random.default_rng(t)) for t, g in enumerate(frames)]


@pytest.fixture(scope="module")
def clean():
    still = random_gaussians(1200)
    return [turned(still, 0.02 * t) for t in range(5)]


@pytest.fixture(scope="module")
def given(clean, tmp_path_factory):
    return faces.open_sequence(write_sequence(tmp_path_factory.mktemp("given"), apart(clean)))


@pytest.fixture(scope="module")
def tracked(given, made_once):
    def make(folder):
        encode_tracked(given, folder / "package.airgs", folder=folder / "work")

    return made_once("tracked", make)


def shown(place):
    package = open_package(place)
    m = package.manifest
    return m.bytes_of(m.rung_files(0, 0)), [faces.decode(package, t) for t in range(m.frames)], m.decisions


def test_tracking_takes_fewer_bytes_and_shows_no_less(clean, given, tracked, tmp_path):
    encode(given, tmp_path / "apart.airgs", SETTINGS)
    before, alone, _ = shown(tmp_path / "apart.airgs")
    after, together, decisions = shown(tracked / "package.airgs")
    assert after < 0.7 * before
    assert np.mean(list(map(mse, together, clean))) < np.mean(list(map(mse, alone, clean)))
    assert any(line.startswith("tracked: 1 key for 5 frames; against what was given") for line in decisions)
    assert not any("trained model" in line for line in decisions)  # it was not trained from pictures


def test_a_run_that_was_cut_off_goes_on(given, tracked, tmp_path):
    work = shutil.copytree(tracked / "work", tmp_path / "work")
    [model] = work.glob("tracked-*")
    first, last = model / "000000.ply", model / "000004.ply"
    data, written = last.read_bytes(), first.stat().st_mtime_ns
    record = json.loads((model / "training.json").read_text())
    record["frames"] = record["frames"][:2]
    (model / "training.json").write_text(json.dumps(record))
    encode_tracked(given, tmp_path / "second.airgs", folder=work)
    assert (last.read_bytes(), first.stat().st_mtime_ns) == (data, written)


def test_frames_of_other_scenes_and_rows_that_are_in_order_are_not_tracked(clean, tmp_path):
    others = [random_gaussians(300 + t, seed=t) for t in range(3)]
    others = [replace(g, sh_dc=g.sh_dc + np.float32([2, -2, 2][t])) for t, g in enumerate(others)]
    for frames, words in (
        (others, "; each is coded by itself"),
        (clean[:2], "not tracked: its rows are in order already"),
    ):
        encode_tracked(GaussianSequence.from_arrays(frames), tmp_path / "out.airgs")
        _, found, decisions = shown(tmp_path / "out.airgs")
        [line] = [line for line in decisions if line.startswith("not tracked:")]
        assert len(found) == len(frames) and line.endswith(words)


class Elsewhere(Executor):
    """Calls functions in this process, but hands over bytes, as executors do whose workers are elsewhere."""

    def submit(self, function, /, *arguments):
        done = Future()
        done.set_result(function(*pickle.loads(pickle.dumps(arguments))))
        return done


def test_chunks_are_tracked_alike_whoever_does_them_and_two_frames_as_well(tmp_path, monkeypatch):
    still = random_gaussians(300)
    frames = apart([turned(still, 0.02 * t) for t in range(3)])
    cameras = faces.orbit_views(frames[0], count=4, size=64)
    few, two = (GaussianSequence.from_arrays(frames[:count], cameras=cameras) for count in (3, 2))
    monkeypatch.setattr(track, "CHUNK_FRAMES", 2)
    quick = replace(track.track_settings(few), first_iterations=40, keyframe_iterations=30, frame_iterations=20)
    monkeypatch.setattr(track, "track_settings", lambda sequence: quick)
    encode_tracked(few, tmp_path / "alone.airgs")
    encode_tracked(few, tmp_path / "jobs.airgs", Elsewhere())
    assert read_files(tmp_path / "alone.airgs") == read_files(tmp_path / "jobs.airgs")
    m = open_package(tmp_path / "alone.airgs").manifest
    assert 2 in [group.start for group in m.groups]
    assert any(line.startswith("tracked: 2 keys for 3 frames") for line in m.decisions)
    encode_tracked(two, tmp_path / "two.airgs")
    _, (first, second), decisions = shown(tmp_path / "two.airgs")
    assert len(first) == len(second) and any(line.startswith("tracked: 1 key for 2 frames") for line in decisions)


def test_frames_that_share_no_rows_are_tracked_unless_somebody_says_otherwise(clean, given, tmp_path, capsys):
    tracks, line = track.decide(given)
    assert tracks and "--no-track" in line
    assert "tracked first, which takes a thirteenth" in line, line
    for wanted, rows in ((False, "auto"), (None, "match")):
        tracks, line = track.decide(given, wanted, rows)
        assert not tracks and "coded one by one; " in line and "--track" in line
    for rows in (clean, [g.take(np.random.default_rng(t).permutation(len(g))) for t, g in enumerate(clean)]):
        tracks, line = track.decide(GaussianSequence.from_arrays(rows))
        assert not tracks and "track" not in line
    for words in (
        [given.folder, "--rows", "keep"],
        [given.folder, "--follow"],
        [FOX_VIEWS, "-o", tmp_path / "y.airgs"],
    ):
        assert faces.airgs_encode([*map(str, words), "--track"]) == 2
    assert "--rows: expected auto with --track, which leaves rows in order, got keep\n" in capsys.readouterr().err
    assert faces.airgs_encode([str(given.folder), "--preset", "fast", "--plan"]) == 0  # a first look tracks nothing
    out, err = capsys.readouterr()
    assert "--track makes one set of moving Gaussians of them first" in err
    assert faces.Plan.from_json(out.encode()).groups == ((0, 5),)


def test_a_folder_of_frames_is_trained_into_a_model_that_encodes_as_it_is(given, clean, tmp_path, capsys, monkeypatch):
    quick = replace(track.track_settings(given), keyframe_iterations=20, frame_iterations=20)
    for module in ("trainer.track", "cli.train"):
        monkeypatch.setattr(f"airgs_codec.{module}.track_settings", lambda sequence: quick)
    words = [str(given.folder), "-o", str(tmp_path / "m"), "--device", "cpu"]
    assert faces.airgs_train([*words, "--sync", "off"]) == 2 and faces.airgs_train(words) == 0
    out, err = capsys.readouterr()
    assert "--sync: expected multi-view" in err and "tracked first, which" in err and "5 frames of 64x64, 32" in out
    model = airgs.train(given, tmp_path / "p", device="cpu")
    assert files(tmp_path / "p")[0] == files(tmp_path / "m")[0] and model.finished()
    compared = []
    monkeypatch.setattr("airgs_codec.inspect.report.write_report", lambda _, sequence, *__: compared.append(sequence))
    assert faces.airgs_encode([words[0], "-o", str(tmp_path / "x"), "--device", "cpu", "--report", str(tmp_path)]) == 0
    assert [len(g) for g in compared[0]] == [len(g) for g in given], "the report has what was given beside the package"
    sequence = faces.open_sequence(tmp_path / "m")
    assert len({header.count for header in sequence.headers}) == 1 and sequence.notes[-1].startswith("tracked: 1 key")
    with pytest.raises(faces.SceneError, match="not tracked: its rows are in order already"):
        airgs.train(GaussianSequence.from_arrays(clean[:2]), tmp_path / "o", device="cpu")


def test_rows_go_where_the_frame_has_them_and_turn_with_their_neighbours_as_expected(clean):
    def turned_alike(moved, there):
        """Whether the median row is turned as that of another frame, to 0.01 radians, half of a turn."""
        alike = np.abs(np.sum(moved.quaternions * there.quaternions, axis=1))
        alike /= np.linalg.norm(moved.quaternions, axis=1) * np.linalg.norm(there.quaternions, axis=1)
        return np.median(alike) > np.cos(0.005)

    moved = carry(clean[0], predicted(clean[2], np.random.default_rng(0)))
    there, here = (np.linalg.norm(g.means - clean[2].means, axis=1) for g in (moved, clean[0]))
    assert np.median(there) < 0.15 * np.median(here)
    assert turned_alike(moved, clean[2])
    moved = carry(clean[2], predicted(clean[3], np.random.default_rng(0)), clean[2].means - clean[1].means)
    assert turned_alike(moved, clean[3]) and not turned_alike(clean[2], clean[3])
