"""What reports of sessions and studies conclude: every sentence has data that say the opposite, and then it does."""

from dataclasses import replace

import pytest

from airgs_codec.package.manifest import on_ladder
from airgs_codec.play.report import ASKED, BELOW, FAULTS, OVER, SHORT, beaten_words, find_stalls
from airgs_codec.play.study import Study, StudySettings, study_answer
from tests.faces import Offers, SessionSettings, answer, simulate
from tests.play.test_session import link, play
from tests.support.manifests import missing, tiny_manifest

TINY = tiny_manifest()  # its rungs take 50.4 to 18.4 kbit/s
LOST = missing(*(TINY.state_files(1, level)[0] for level in range(3)))


@pytest.mark.parametrize(
    ("log", "why"),
    [
        (play(TINY, link([1.5e4]), "fixed:Q1+L2", loops=3), BELOW),
        (play(TINY, link([4e4]), loops=3), ASKED),
        (play(TINY, link([8e4, 8e4, *[3e4] * 30]), "throughput", loops=4), OVER),
        (play(TINY, link([5.1e4]), loops=8), SHORT),
        (play(TINY, link([4e4]), "robust-mpc", faults=LOST, loops=2), FAULTS),
    ],
)
def test_every_wait_has_its_reason_and_its_advice(log, why):
    stalls = find_stalls(log)
    assert stalls and sum(stall.seconds for stall in stalls) == pytest.approx(log.metrics.stall_s)
    assert why in {stall.why for stall in stalls}
    told = answer(log)
    assert f"waited for {log.metrics.stall_s:.1f} s" in told["wrong"] and why in told["wrong"]
    helps = {BELOW: "--levels", ASKED: "--policy robust-mpc", OVER: "--policy robust-mpc"}
    assert (helps | {SHORT: "--player.startup", FAULTS: "validate"})[why] in told["change"]


def test_a_larger_buffer_is_advised_only_where_the_link_carries_enough_at_times():
    rates = ([8e4, 8e4, 0, 0, 0, 0], [1.5e4])
    outage, thin = (answer(play(TINY, link(r), "fixed:Q1+L2", loops=8, buffer_s=2.0)) for r in rates)
    assert BELOW in outage["wrong"] and "--player.buffer" in outage["change"]
    assert BELOW in thin["wrong"] and "--player.buffer" not in thin["change"] and "--levels" in thin["change"]


def test_who_never_waits_is_told_so():
    told = answer(play(TINY, link([8e6])))
    assert told["wrong"].startswith("Nothing: the viewer never waited")
    assert "40.0 dB on average, 40.0 in its worst tenth" in told["good"]
    assert "waited" not in answer(play(TINY, link([8e4]), faults=LOST, loops=2))["wrong"]


def test_lost_files_are_to_be_looked_at():
    whole, broken = (answer(play(TINY, link([8e4]), faults=faults)) for faults in ({}, LOST))
    assert "10 frames were lost" in broken["wrong"] and "airgs-manifest validate" in broken["change"]
    assert "lost" not in whole["wrong"] and "validate" not in whole["change"]


def test_the_worst_tenth_is_that_of_the_screen():
    log = play(tiny_manifest(psnr=[[40.0, 36.0], [38.0, 35.0], [20.0, 18.0]]), link([8e6]), "fixed:2")
    assert "20.0 dB on average, 20.0 in its worst tenth" in answer(log)["good"]
    assert "not measured" in answer(play(tiny_manifest(psnr=None), link([8e6])))["good"]


def test_the_default_policy_is_not_recommended_to_itself():
    rules = SessionSettings(startup_s=0.0, loops=30)
    log = simulate(Offers(TINY), link([*[2e5] * 20, *[1e3] * 20]), "robust-mpc", rules)
    assert "--policy" not in answer(log)["change"] and "--player.buffer 20" in answer(log)["change"]


def test_a_link_that_carries_more_or_a_policy_that_shows_less_is_told_of():
    wide, narrow = (answer(play(TINY, link([rate]), loops=8))["change"] for rate in (8e5, 5.2e4))
    assert "finer ones" in wide and "finer ones" not in narrow
    assert "--compare" in answer(play(TINY, link([8e5]), "fixed:2"))["change"] and "--compare" not in wide


def test_rungs_that_others_beat_are_named_and_what_only_takes_room():
    assert on_ladder([(100, 40.0), (90, 30.0), (50, 35.0), (60, None)]) == [True, False, True, False]
    words = beaten_words({"Q0+L0": True, "Q0+L1": False, "Q1+L0": True, "Q1+L1": False})
    assert words.startswith("No player should fetch Q0+L1 and Q1+L1") and "L1 could be left out" in words
    assert "parts of others" in beaten_words({"Q0+L0": True, "Q0+L1": False, "Q1+L1": True})
    assert beaten_words({"Q0+L0": True, "Q1+L1": True}) == ""


def test_rungs_that_were_shown_are_not_called_unseen():
    told = answer(play(TINY, link([8e6]), "fixed:Q1+L2"))["useless"]
    unseen = told.split("Not shown")[1]
    assert "Q0+L0" in unseen and "Q1+L2" not in unseen


def study(qoe, traces=8, feasible=True, rungs=("Q0+L0",)):
    """A study in which every policy has a QoE that is a little better on later traces; the default is one of them."""
    rows = [
        {"trace": f"t{t}", "policy": policy, "feasible": feasible or t > 0, "qoe": value + 0.1 * t, "psnr_mean": 40.0}
        | {"stall_ratio": 0.0 if feasible or t else 0.5, "regret": 1.0, "rungs": {"Q0+L0": 3}}
        for t in range(traces)
        for policy, value in qoe.items()
    ]
    return Study(StudySettings(tuple(qoe), ("t",)), "p", tuple(rows), rungs)


def test_a_study_recommends_what_did_best_on_its_links():
    told = study_answer(study({"robust-mpc": 38.0, "bola": 40.0, "paper": 39.0}))
    assert (
        told["good"].startswith("bola does best on 8 links") and "1.00 dB above that of paper, the next" in told["good"]
    )
    assert "chance" not in told["good"] and told["change"] == "Play with --policy bola."
    other = study_answer(study({"robust-mpc": 40.0, "bola": 38.0}))
    assert other["good"].startswith("robust-mpc") and other["change"] == "Stay with robust-mpc, the default."


def test_few_links_or_small_differences_are_not_sold_as_sure():
    told = study_answer(study({"robust-mpc": 38.0, "bola": 40.0}, traces=2))
    assert "may be chance" in told["good"] and "Give more --traces" in told["change"]


def test_a_study_of_a_package_that_was_not_measured_tells_of_waiting_alone():
    def told(traces, waits):
        plain = study(dict.fromkeys(waits, 0.0), traces)
        known = ({"stall_ratio": waits[row["policy"]]} for row in plain.rows)
        none = dict.fromkeys(("qoe", "psnr_mean", "regret"))
        return study_answer(replace(plain, rows=tuple(a | none | b for a, b in zip(plain.rows, known, strict=True))))

    many, few = (told(traces, {"robust-mpc": 0.2, "fixed:1": 0.1}) for traces in (8, 2))
    assert many["good"].startswith("fixed:1 does best on 8 links: what it shows was not measured, and it waits 10.0 %")
    assert "robust-mpc, the next, waits 10.0 % more" in many["good"] and many["change"] == "Play with --policy fixed:1."
    assert "may be chance" in few["good"] and "10.0 % less waiting than robust-mpc" in few["change"]
    assert not any(word in words for one in (many, few) for words in one.values() for word in ("nan", "dB"))
    assert told(8, {"fixed:1": 0.0})["wrong"] == "Nothing: nobody waits."


def test_oracles_are_no_players():
    told = study_answer(study({"robust-mpc": 38.0, "oracle-lp": 50.0}))
    assert told["good"].startswith("robust-mpc") and "oracle" not in told["change"]


def test_links_that_carry_too_little_ask_for_a_lower_level():
    hard, easy = (study_answer(study({"robust-mpc": 38.0}, feasible=feasible)) for feasible in (False, True))
    assert "On 1 of 8 links no policy helps" in hard["wrong"] and "waits 50.0 %" in hard["wrong"]
    assert "--levels" in hard["change"] and "--levels" not in easy["change"] and "no policy" not in easy["wrong"]


def test_rungs_that_no_policy_showed_are_named():
    assert "Q1+L1" in study_answer(study({"robust-mpc": 38.0}, rungs=("Q0+L0", "Q1+L1")))["useless"]
    assert study_answer(study({"robust-mpc": 38.0}))["useless"] == ""
