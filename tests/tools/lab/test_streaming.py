"""What viewers get over links: every policy is played, and the answers say what the rows say."""

import shutil

import pytest

from tests.support.paths import FOX
from tools.lab.bench.streaming import CLIFF, NO_CLIFF, Options, best_words, cliff_words, default_words, run
from tools.lab.command import Lab
from tools.lab.page import write_picture


def row(policy, psnr, stalled, scene="fox", **more):
    return {"scene": scene, "policy": policy, "psnr": psnr, "stalled": stalled, "regret": 0.26} | more


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
        "With mpc, fox has 42.3 dB on the screen, 0.3 dB below the best that any player could show, and waits 0.7 % of "
        "the time; spinach has 40.0 dB, 0.3 dB below, and waits 2.0 %."
    )


@pytest.mark.parametrize(
    ("psnr", "low", "stalled", "better"),
    [
        (43.0, 40.0, 0.005, True),
        (41.98, 40.5, 0.01, True),
        (42.0, 39.98, 0.0103, False),
        (43.0, 40.0, 0.02, False),
        (41.0, 41.0, 0.005, False),
    ],
)
def test_a_policy_is_better_that_is_worse_in_nothing(psnr, low, stalled, better):
    rows = [row("mpc", 42.0, 0.01, low=40.0), row("bola", psnr, stalled, low=low)]
    assert best_words(rows).startswith("Better in some" if better else "No other policy is better")
    assert ("bola (fox)." in best_words(rows)) is better


@pytest.mark.parametrize(
    ("with_it", "words"),
    [
        ((42.5, 0.024), "With the cliff test of the paper, viewers wait 20 % longer for 0.50 dB more (fox)."),
        ((41.9, 0.015), "With the cliff test of the paper, viewers wait 25 % shorter for 0.10 dB less (fox)."),
        ((42.001, 0.02), "With the cliff test of the paper, viewers wait as long as without (fox)."),
    ],
)
def test_the_cliff_test_costs_or_spares(with_it, words):
    rows = [row(CLIFF, *with_it), row(NO_CLIFF, 42.0, 0.02)]
    assert cliff_words(rows) == words
    assert cliff_words(rows[:1]) == ""
