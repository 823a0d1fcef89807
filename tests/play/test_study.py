"""Studies and reports of sessions: every sentence they conclude has data that say the opposite, and then it does."""

import html
import itertools
import json
from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.places.whole import to_json
from tests import faces
from tests.faces import Offers, SessionSettings, Study, StudySettings, airgs_play, answer, simulate, study_answer
from tests.support.manifests import link, missing, play, rules, tiny_manifest

TINY = tiny_manifest()  # its rungs take 50.4 to 18.4 kbit/s
UNMEASURED = tiny_manifest(psnr=None)
LOST = missing(*(TINY.delta_files(1, level)[0] for level in range(3)))
NONE = "No difference found"
FAULTS, BELOW = "files had to be asked for again", "the link gave less than the lowest rung needs"
ASKED = "the policy asked for more than the link gave"
SHORT = "too little was buffered for what came next"
BOLA, WAITING = {"robust-mpc": 38.0, "bola": 40.0}, {"robust-mpc": 0.2, "fixed:1": 0.1}
OUTAGE, THIN = (
    play(TINY, link(rates), "fixed:Q1+L2", loops=8, buffer_s=2.0) for rates in ([8e4, 8e4, 0, 0, 0, 0], [1.5e4])
)
SMOOTH, LOSSES = (play(TINY, link([rate]), faults=faults) for rate, faults in ((8e6, ()), (8e4, LOST)))
DARK = play(tiny_manifest(psnr=[[40.0, 36.0], [38.0, 35.0], [20.0, 18.0]]), link([8e6]), "fixed:2")
DEFAULT = simulate(Offers(TINY), link([*[2e5] * 20, *[1e3] * 20]), settings=SessionSettings(startup_s=0.0, loops=30))


@pytest.mark.parametrize(("log", "why", "change"), [
    (play(TINY, link([1.5e4]), "fixed:Q1+L2", loops=3), BELOW, "--levels"),
    (play(TINY, link([4e4]), loops=3), ASKED, "--policy robust-mpc"),
    (play(TINY, link([8e4, 8e4, *[3e4] * 30]), "throughput", loops=4), ASKED, "--policy robust-mpc"),
    (play(TINY, link([5.1e4]), loops=8), SHORT, "--player.startup"),
    (play(TINY, link([4e4]), "robust-mpc", faults=LOST, loops=2), FAULTS, "validate"),
])  # fmt: skip
def test_every_wait_has_its_reason_and_its_advice(log, why, change):
    waits = faces.find_waits(log)
    assert sum(waits.values()) == pytest.approx(log.metrics.stall_s) and waits[why] > 0
    told = answer(log)
    assert f"waited for {log.metrics.stall_s:.1f} s" in told["wrong"] and why in told["wrong"]
    assert change in told["change"]


@pytest.mark.parametrize(("log", "part", "words", "absent"), [
    (OUTAGE, "wrong", BELOW, ASKED),
    (OUTAGE, "change", "--player.buffer", "validate"),  # where the link carries enough at times
    (THIN, "wrong", BELOW, ASKED),
    (THIN, "change", "--levels", "--player.buffer"),
    (SMOOTH, "wrong", "Nothing: the viewer never waited", "lost"),
    (SMOOTH, "good", "40.0 dB on average, 40.0 dB as its 5th", "not measured"),
    (SMOOTH, "change", "", "validate"),
    (LOSSES, "wrong", "10 frames were lost", "waited"),
    (LOSSES, "change", "airgs-manifest validate", "--levels"),
    (play(TINY, link([8e4]), faults=LOST, loops=2), "wrong", "lost", "waited"),
    (DARK, "good", "20.0 dB on average, 20.0 dB as its 5th", "40.0"),  # of the screen
    (play(UNMEASURED, link([8e6])), "good", "not measured", "dB"),
    (DEFAULT, "change", "--player.buffer 20", "--policy"),  # it is not recommended to itself
    (play(TINY, link([8e5]), loops=8), "change", "finer ones", "--compare"),  # the link carries more
    (play(TINY, link([5.2e4]), loops=8), "change", "", "finer ones"),
    (play(TINY, link([8e5]), "fixed:2"), "change", "--compare", "finer ones"),  # a policy that shows less
    (play(TINY, link([8e6]), "fixed:Q1+L2"), "useless", "Not shown on this link: Q0+L0", "Q1+L2"),
])  # fmt: skip
def test_what_a_session_comes_to(log, part, words, absent):
    told = answer(log)[part]
    assert words in told and absent not in told


def test_rungs_that_others_beat_are_named():
    assert faces.on_ladder([(100, 40.0), (90, 30.0), (50, 35.0), (60, None)]) == [True, False, True, False]
    words = faces.beaten_words({"Q0+L0": True, "Q0+L1": False, "Q1+L0": True, "Q1+L1": False})
    assert words.startswith("No player should fetch Q0+L1 and Q1+L1")
    assert faces.beaten_words({"Q0+L0": True, "Q1+L1": True}) == ""


def test_a_report_is_written_where_it_can_be(tmp_path):
    log = simulate(Offers(TINY, 0, 1000), link([4e4, 0, 2e5], rtt=0.08), settings=SessionSettings(loops=5))
    text = faces.write_report(log, tmp_path / "report").read_text()
    assert text.count("data:image/svg") == text.count("<figure") == 1
    assert all(words in html.unescape(text) for words in answer(log).values())
    unmeasured = play(UNMEASURED, link([8e6]))
    assert "not measured" in faces.write_report(unmeasured, tmp_path / "bare").read_text()
    assert "not measured" in faces.format_metrics(unmeasured)
    (tmp_path / "file").write_text("")
    with pytest.raises(faces.ConfigError, match="cannot write"):
        faces.write_report(log, tmp_path / "file")


def study(values, traces=8, feasible=True, measured=True, luck=()):
    """A study in which every policy has a QoE that is a little better on later traces; the default is one of them.

    Where quality was not measured, the values are the shares of the time that policies wait.
    """
    rows = []
    for t, (policy, value) in itertools.product(range(traces), values.items()):
        fits = feasible or t > 0
        more = dict(luck).get(policy, (-1, 0.0))
        row = {
            "qoe": value + 0.1 * t + (t == more[0]) * more[1],
            "psnr_mean": 40.0,
            "stall_ratio": 0.0 if fits else 0.5,
            "regret": 1.0,
        }
        if not measured:
            row = {"qoe": None, "psnr_mean": None, "stall_ratio": value, "regret": None}
        rows.append(row | {"trace": f"t{t}", "policy": policy, "feasible": fits})
    return Study(StudySettings(tuple(values), ("t",)), "p", tuple(rows))


@pytest.mark.parametrize(("some", "expected", "absent"), [
    (study(BOLA | {"paper": 39.0}), ["bola shows 40.0 dB and waits 0.0 % of the time on 8 links",
                                     "1.00 dB above that of paper, the next", "Play with --policy bola."], [NONE]),
    (study({"robust-mpc": 40.0, "bola": 38.0}), ["2.00 dB above that of bola", "Stay with robust-mpc, the default."],
     ["Play with", "--levels", NONE]),
    (study(BOLA, traces=2), [f"{NONE} to bola (-2.00 to -2.00 over traces)", "Give 6 --traces", "Stay with"], ["Play"]),
    # It does better on all traces but one, where it does much worse.
    (study(BOLA, luck={"bola": (0, -9.0)}), [f"{NONE} to bola", "Stay with"], ["above", "Play with", "Give"]),
    # Of a package that was not measured waiting alone is told.
    (study(WAITING, measured=False),
     ["fixed:1 shows what was not measured, and waits 10.0 %", "It waits 10.0 % less than robust-mpc, the next",
      "Play with --policy fixed:1."], ["nan", "dB", NONE]),
    (study(WAITING, 2, measured=False), [f"{NONE} to fixed:1", "Stay with robust-mpc"], ["nan", "dB"]),
    (study({"fixed:1": 0.0}, measured=False), ["The smallest rungs play on all links."], ["nan"]),
    (study({"robust-mpc": 38.0, "oracle-lp": 50.0}), ["robust-mpc shows"], ["oracle"]),  # no player
    (study({"robust-mpc": 38.0}, feasible=False), ["On 1 of 8 links even", "waits 50.0 %", "--levels"], []),
    (study({"robust-mpc": 38.0}), [], ["--levels"]),
])  # fmt: skip
def test_what_a_study_recommends(some, expected, absent):
    told = " ".join(study_answer(some).values())
    assert [words for words in expected if words not in told] == [words for words in absent if words in told] == []


def test_offsets_are_seeded_and_a_traces_own():
    trace, other = faces.Trace.open("markov:1"), faces.Trace.open("markov:2")
    first, again, second = (faces.offsets_of(trace, 4, seed) for seed in (1, 1, 2))
    assert first == again != second != faces.offsets_of(other, 4, 2)
    assert all(0 <= o < trace.duration_s for o in faces.offsets_of(trace, 100, 3))


def test_feasible_means_that_the_smallest_rungs_keep_up():
    for rate, loops, expected in ((2300, 10, True), (2000, 30, False)):  # exactly what a second of Q1+L2 takes, or less
        assert faces.is_feasible(Offers(TINY, 0, 1000), link([8 * rate]), rules(buffer_s=10.0), loops) is expected


def test_intervals_are_over_traces():
    values = np.array([1.0, 1.0, 3.0, 3.0, np.nan])
    assert faces.interval(values, ["a", "a", "b", "b", "b"]) == (2.0, 1.0, 3.0)  # two traces, however many offsets
    assert np.isnan(faces.interval(np.array([np.nan]), ["a"])).all()


def test_a_study_compares_on_the_same_links_and_repeats_exactly(demo_package, capsys):
    """By the command with a trace at a time, and with two at once."""
    policies = "robust-mpc", *(name for name in faces.NAMES if name != "robust-mpc"), "fixed:0"
    traces = "markov:1:6", "const:9"
    settings = StudySettings(policies, traces, 2, session=replace(SessionSettings(), loops=10), jobs=2)
    found = faces.run_study(demo_package, settings)
    options = ["--traces", *traces, "--offsets", "2", "--player.loops", "10", "--jobs", "1", "--json"]
    assert airgs_play([str(demo_package), "--compare", *options, "--policies", ",".join(policies)]) == 0
    printed = capsys.readouterr().out
    assert printed.strip() == to_json(faces.study_record(found))
    text, record = faces.format_study(found), json.loads(printed)
    assert "2 traces, 2 offsets each (seed 1), rates x1," in text and "mean over display ticks" in text
    assert "links whose smallest rungs" in text and "oracle-lp" in text and " of the time on 4 links" in text
    assert [r["sessions"] for r in record["all"]] == [4] * len(policies)
    assert all(r["figures"]["regret"][0] >= -1e-6 for r in record["all"])


def test_damaged_packages_play_on(demo_copy, tmp_path, capsys):
    package, film = faces.open_package(demo_copy), tmp_path / "film.mp4"
    assert faces.find_faults(package) == {}
    first, second = (package.manifest.delta_files(0, j)[0] for j in (0, 1))
    (demo_copy / first).unlink()
    (demo_copy / second).write_bytes(b"x" * package.manifest.entry(second).bytes)
    faults = faces.find_faults(package)
    assert (faults[first].reason, faults[second].reason) == ("missing_file", "hash_mismatch")
    play = [str(demo_copy), "--trace", "const:50", "--player.loops", "1", "--video", str(film)]
    assert airgs_play([*play, "--policy", "fixed:0"]) == 0
    assert first in capsys.readouterr().out and film.exists()
    for group in range(len(package.manifest.groups)):
        (demo_copy / package.manifest.keyframe_files(group, 0, 0)[0]).unlink()
    assert airgs_play(play) == 2
    assert "nothing can be shown" in capsys.readouterr().err
    assert airgs_play(play[:5]) == 0
    assert "no rung can be had" in capsys.readouterr().out
