"""Tracking: frames that know nothing of each other take fewer bytes, and show what they have in common."""

import json
import re
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.analysis.flow import carry
from airgs_codec.encoder.track import decide
from tests.faces import (
    ConfigError,
    EncodeSettings,
    GaussianSequence,
    Processes,
    Work,
    airgs_encode,
    as_preview,
    decode,
    encode,
    from_rotation_vector,
    multiply,
    open_package,
    open_sequence,
    open_store,
    orbit_views,
    render,
    to_matrices,
)
from tests.support.paths import FOX_VIEWS
from tests.support.scenes import predicted, random_gaussians, write_sequence

SETTINGS = as_preview(EncodeSettings(track=True, threads=1, device="cpu"))


def turned(g, angle):
    """A scene that turns about y and moves along x."""
    q = from_rotation_vector(np.array([0.0, angle, 0.0]))
    means = g.means @ to_matrices(q).T + [angle, 0, 0]
    quaternions = multiply(q, g.quaternions.astype(np.float64))
    return replace(g, means=means.astype(np.float32), quaternions=quaternions.astype(np.float32))


def mse(a, b):
    return float(np.mean([(render(a, view).rgb - render(b, view).rgb) ** 2 for view in orbit_views(b, 5, 96)]))


@pytest.fixture(scope="module")
def clean():
    still = random_gaussians(1200)
    return [turned(still, 0.02 * t) for t in range(5)]


@pytest.fixture(scope="module")
def given(clean, tmp_path_factory):
    """The clean frames as if each had been made by itself."""
    frames = [predicted(g, np.random.default_rng(t)) for t, g in enumerate(clean)]
    return open_sequence(write_sequence(tmp_path_factory.mktemp("given"), frames))


def encoded(sequence, place, settings):
    """Bytes of a top rung, its frames, and what was decided."""
    m = encode(sequence, place, settings).manifest
    package = open_package(place)
    return m.bytes_of(m.rung_files(0, 0)), [decode(package, t) for t in range(m.frames)], m.decisions


def test_tracking_takes_fewer_bytes_and_shows_no_less(clean, given, tmp_path):
    before, apart, _ = encoded(given, tmp_path / "apart.airgs", replace(SETTINGS, track=False))
    after, tracked, decisions = encoded(given, tmp_path / "tracked.airgs", SETTINGS)
    assert after < 0.7 * before
    assert np.mean(list(map(mse, tracked, clean))) < np.mean(list(map(mse, apart, clean)))
    assert any(line.startswith("tracked: 1 key for 5 frames; against what was given") for line in decisions)
    assert not any("trained model" in line for line in decisions)  # it was not trained from pictures


def test_a_run_that_was_cut_off_goes_on(given, tmp_path):
    work = Work(open_store(tmp_path / "work"))
    encode(given, tmp_path / "first.airgs", SETTINGS, work=work)
    [model] = (tmp_path / "work").glob("tracked-*")
    last = (model / "000004.ply").read_bytes()
    record = json.loads((model / "training.json").read_text())
    record["frames"] = record["frames"][:2]
    (model / "training.json").write_text(json.dumps(record))
    first = (model / "000000.ply").stat().st_mtime_ns
    encode(given, tmp_path / "second.airgs", SETTINGS, work=work)
    assert (model / "000004.ply").read_bytes() == last
    assert (model / "000000.ply").stat().st_mtime_ns == first


def test_frames_of_other_scenes_are_coded_one_by_one(tmp_path):
    frames = [random_gaussians(300 + t, seed=t) for t in range(3)]
    others = [replace(g, sh_dc=g.sh_dc + [2, -2, 2][t]) for t, g in enumerate(frames)]
    sequence = open_sequence(write_sequence(tmp_path / "scene", others))
    _, shown, decisions = encoded(sequence, tmp_path / "others.airgs", SETTINGS)
    assert len(shown) == 3
    assert any(line.startswith("not tracked:") and "coded by itself" in line for line in decisions)


def test_rows_that_are_in_order_are_not_tracked_again(clean, tmp_path):
    sequence = open_sequence(write_sequence(tmp_path / "scene", clean[:2]))
    _, _, decisions = encoded(sequence, tmp_path / "clean.airgs", SETTINGS)
    assert "not tracked: its rows are in order already" in decisions


def test_chunks_are_tracked_alike_whoever_does_them(given, tmp_path, monkeypatch):
    monkeypatch.setattr("airgs_codec.encoder.track.CHUNK", 3)
    encode(given, tmp_path / "alone.airgs", SETTINGS)
    with closing(Processes(2)) as engine:
        encode(given, tmp_path / "jobs.airgs", SETTINGS, work=Work(open_store(tmp_path / "jobs"), engine))
    alone, jobs = (
        {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
        for folder in (tmp_path / f"{name}.airgs" for name in ("alone", "jobs"))
    )
    assert alone == jobs
    starts = [group.start for group in open_package(tmp_path / "alone.airgs").manifest.groups]
    assert 3 in starts


def test_frames_that_share_no_rows_are_tracked_unless_somebody_says_otherwise(clean, given, tmp_path):
    auto = EncodeSettings()
    settings, line = decide(given, auto)
    assert settings.track and "--no-track" in line
    assert re.search(r"tracked first: about \d+ to \d+ s, then about \d\.\d to \d\.\d kB a frame", line), line
    for left in (as_preview(auto), replace(auto, track=False), replace(auto, rows="match")):
        settings, line = decide(given, left)
        assert not settings.track and "coded one by one, about " in line and "--track" in line
    for rows in (clean, [g.take(np.random.default_rng(t).permutation(len(g))) for t, g in enumerate(clean)]):
        settings, line = decide(GaussianSequence.from_arrays(rows), auto)
        assert not settings.track and "track" not in line


def test_two_frames_are_tracked(given, tmp_path):
    sequence = GaussianSequence.from_arrays([given.read(0), given.read(1)])
    _, shown, decisions = encoded(sequence, tmp_path / "two.airgs", SETTINGS)
    assert len(shown) == 2 and len(shown[0]) == len(shown[1])
    assert any(line.startswith("tracked: 1 key for 2 frames") for line in decisions)


def test_options_that_contradict_are_refused(given, tmp_path):
    with pytest.raises(ConfigError, match=r"rows: expected auto with track, .* got keep"):
        encode(given, tmp_path / "x.airgs", replace(SETTINGS, rows="keep"))
    assert airgs_encode([str(given.folder), "--track", "--follow"]) == 2
    assert airgs_encode([str(FOX_VIEWS), "--track", "-o", str(tmp_path / "y.airgs")]) == 2


def test_rows_go_where_the_frame_has_them(clean):
    other = predicted(clean[2], np.random.default_rng(0))
    moved = carry(clean[0], other)
    there, here = (np.linalg.norm(g.means - clean[2].means, axis=1) for g in (moved, clean[0]))
    assert np.median(there) < 0.15 * np.median(here)
    assert turned_alike(moved, clean[2])


def test_rows_that_go_on_as_expected_turn_with_their_neighbours(clean):
    moved = carry(clean[2], predicted(clean[3], np.random.default_rng(0)), clean[2].means - clean[1].means)
    assert turned_alike(moved, clean[3]) and not turned_alike(clean[2], clean[3])


def turned_alike(moved, there):
    """Whether the median row is turned as that of another frame, to 0.01 radians, half of a turn."""
    alike = np.abs(np.sum(moved.quaternions * there.quaternions, axis=1))
    alike /= np.linalg.norm(moved.quaternions, axis=1) * np.linalg.norm(there.quaternions, axis=1)
    return np.median(alike) > np.cos(0.005)
