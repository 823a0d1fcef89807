"""What viewers get over links: every policy is played, and the answers say what the rows say."""

import shutil

import pytest

from tests.support.paths import FOX
from tools.lab.bench.streaming import CLIFF, NO_CLIFF, Options, best_words, cliff_words, default_words, run
from tools.lab.command import Lab
from tools.lab.page import write_picture


def row(policy, psnr, stalled, scene="fox", **more):
    return {"scene": scene, "policy": policy, "psnr": psnr, "stalled": stalled, "regret": 0.25} | more


def test_every_policy_is_played_and_a_study_is_not_played_again(demo_package, tmp_path):
    traces, lab = tmp_path / "traces", Lab.at(tmp_path / "out", quiet=True)
    traces.mkdir()
    shutil.copy(FOX / "trace.csv", traces / "one.csv")
    options = Options(traces, (str(demo_package),), ("throughput", CLIFF, NO_CLIFF), starts=2, seconds=2, jobs=1)
    page = run(options, lab)
    (section,), (table,) = page.sections, page.tables()
    assert [row["policy"] for row in table.rows] == ["throughput", CLIFF, NO_CLIFF]
    assert all(row["of"] == 2 and 0 < row["least_mbps"] < row["most_mbps"] for row in table.rows)
    assert "2 s, over 1 traces of" in page.how and "80 ms round trip, 10 s of buffer" in page.how
    assert section.answer.startswith("With throughput, ") and "cliff test" in section.answer
    write_picture(section.pictures[0], tmp_path / "streaming.png")
    assert run(options, lab).tables()[0].rows == table.rows


def test_the_first_policy_is_told_of_in_every_scene():
    rows = [row("mpc", 42.34, 0.0066), row("bola", 41.0, 0.0), row("mpc", 40.0, 0.02, "spinach")]
    assert default_words(rows) == (
        "With mpc, fox has 42.3 dB on the screen, 0.25 dB below the best that any player could show, and waits 0.7 % "
        "of the time; spinach has 40.0 dB on the screen, 0.25 dB below the best that any player could show, and "
        "waits 2.0 % of the time."
    )


@pytest.mark.parametrize(
    ("psnr", "stalled", "words"),
    [
        (43.0, 0.005, "Better at both: bola (fox)."),
        (43.0, 0.02, "No other policy is better at both."),
        (41.0, 0.005, "No other policy is better at both."),
    ],
)
def test_a_policy_is_better_that_shows_more_and_waits_less(psnr, stalled, words):
    assert best_words([row("mpc", 42.0, 0.01), row("bola", psnr, stalled)]) == words


@pytest.mark.parametrize(
    ("with_it", "words"),
    [
        ((42.5, 0.024), "The cliff test of the paper makes waits 20 % longer on fox, for 0.50 dB more."),
        ((41.9, 0.015), "The cliff test of the paper makes waits 25 % shorter on fox, for 0.10 dB less."),
    ],
)
def test_the_cliff_test_costs_or_spares(with_it, words):
    rows = [row(CLIFF, *with_it), row(NO_CLIFF, 42.0, 0.02)]
    assert cliff_words(rows) == words
    assert cliff_words(rows[:1]) == ""
