"""Studies and their reports and damaged packages on the command line, each on a small package."""

import json
from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.play.metrics import FIGURES
from airgs_codec.play.session import measure_decoding
from airgs_codec.play.study import StudySettings, interval, is_feasible, offsets_of, run_study, summarise
from tests.faces import Offers, SessionSettings, Trace, airgs_play, draw_views, find_faults, open_package
from tests.play.test_session import link
from tests.support.manifests import tiny_manifest
from tests.support.paths import VALID

MOVING = VALID / "moving"


@pytest.fixture(scope="module")
def moving():
    return open_package(MOVING)


@pytest.fixture(scope="module")
def cameras(moving):
    return draw_views(moving.manifest.region, 3, 5)


def test_offsets_are_seeded_and_a_traces_own():
    trace = Trace.open("markov:1")
    assert offsets_of(trace, 4, 1) == offsets_of(trace, 4, 1) != offsets_of(trace, 4, 2)
    assert offsets_of(trace, 4, 1) != offsets_of(Trace.open("markov:2"), 4, 1)
    assert all(0 <= o < trace.duration_s for o in offsets_of(trace, 100, 3))


def test_feasible_means_that_the_smallest_rungs_keep_up():
    c = Offers(tiny_manifest(), 0, root_bytes=1000)
    rules = SessionSettings(decode_frame_s=0.0, pipelined=False)
    assert is_feasible(c, link([8 * 2300]), rules, 10)  # exactly what a second of Q1+L2 takes
    assert not is_feasible(c, link([8 * 2000]), rules, 30)


def test_intervals_are_over_traces():
    values = np.array([1.0, 1.0, 3.0, 3.0, np.nan])
    mean, low, high = interval(values, ["a", "a", "b", "b", "b"])
    assert mean == 2.0 and low == 1.0 and high == 3.0  # two traces, whatever the number of offsets
    assert np.isnan(interval(np.array([np.nan]), ["a"])).all()


def test_a_study_compares_on_the_same_links(demo_package, capsys):
    options = [
        "--compare",
        "--traces",
        "markov:1:6",
        "const:9",
        "--offsets",
        "2",
        "--player.loops",
        "20",
        "--jobs",
        "1",
    ]
    policies = "robust-mpc,paper,paper-literal,throughput,bola,oracle-frame,oracle-lp,fixed:0"
    assert airgs_play([str(demo_package), *options, "--policies", policies]) == 0
    text = capsys.readouterr().out
    assert "2 traces, 2 offsets each (seed 1), unscaled" in text and "mean over display ticks" in text
    assert "links whose smallest rungs" in text and "oracle-lp" in text and " does best on 4 links" in text
    assert airgs_play([str(demo_package), *options, "--policies", policies, "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert [r["sessions"] for r in record["all"]] == [4] * 8
    assert all(r["figures"]["regret"][0] >= -1e-6 for r in record["all"])
    assert record["all"][0]["differences"]["psnr_mean"] == [0, 0, 0]
    assert "mean over display ticks" in record["figures"]["psnr_mean"] and set(record["figures"]) == {
        figure.name for figure in FIGURES
    }


def test_a_study_repeats_exactly(demo_package):
    settings = StudySettings(("paper", "bola"), ("markov:3:1",), 2, session=replace(SessionSettings(), loops=10))
    a, b = (run_study(demo_package, replace(settings, jobs=jobs)) for jobs in (1, 2))
    assert a.rows == b.rows and summarise(a) == summarise(b)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--compare"], "--traces"),
        (["--compare", "--traces", "none.csv"], "none.csv"),
        (["--compare", "--traces", "const:1", "--policies", "best"], "policy: expected"),
        (["--compare", "--traces", "const:1", "--policies", "paper,paper"], "policies"),
        (["--compare", "--traces", "const:1", "--offsets", "0"], "offset"),
        ([], "--trace"),
        (["--trace", "const:1", "--player.decode-frame", "fast"], "--player.decode-frame"),
        (["--trace", "markov:1:1", "--end", "error", "--player.loops", "3000"], "ends after"),
    ],
)
def test_studies_that_cannot_be(demo_package, options, words, capsys):
    assert airgs_play([str(demo_package), *options]) == 2
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1


def test_an_empty_folder_of_traces(demo_package, tmp_path, capsys):
    assert airgs_play([str(demo_package), "--compare", "--traces", str(tmp_path)]) == 2
    assert "empty" in capsys.readouterr().err


def test_damaged_packages_play_on(demo_copy, tmp_path, capsys):
    package = open_package(demo_copy)
    assert find_faults(package) == {}
    first, second = (package.manifest.state_files(0, j)[0] for j in (0, 1))
    (demo_copy / first).unlink()
    (demo_copy / second).write_bytes(b"x" * package.manifest.entry(second).bytes)
    faults = find_faults(package)
    assert (faults[first].reason, faults[second].reason) == ("missing_file", "hash_mismatch")
    film = tmp_path / "film.mp4"
    play = [str(demo_copy), "--trace", "const:50", "--player.loops", "1", "--video", str(film)]
    assert airgs_play([*play, "--policy", "fixed:0"]) == 0
    assert first in capsys.readouterr().out and film.exists()
    for group in range(len(package.manifest.groups)):
        (demo_copy / package.manifest.key_files(group, 0, 0)[0]).unlink()
    assert airgs_play(play) == 2
    assert "nothing can be shown" in capsys.readouterr().err
    assert airgs_play(play[:5]) == 0
    assert "no rung can be had" in capsys.readouterr().out


def test_decoding_is_timed(moving):
    assert 0 < measure_decoding(moving) < 10
