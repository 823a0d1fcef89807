"""Algorithm 1 of the paper: the cases it leaves undefined, and what must hold whatever the numbers."""

import itertools
import json
import math
from functools import partial
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from airgs_codec.play.ladder import Ladder, Option, saved_shares, select
from airgs_codec.play.policies.paper import frame_budget, select_literal
from tests.faces import ConfigError, Decision

TABLE = json.loads(Path(__file__).with_name("ladder.json").read_text())  # cases that the browser's player reads, too


def dense(*qualities: float, sizes: list[int] | None = None, saved: list[float] | None = None) -> list[Option]:
    """Levels 100 bytes apart that save 10 % more each, unless sizes or shares are given."""
    count = len(qualities)
    sizes, saved = sizes or [100 * (count - i) for i in range(count)], saved or [0.1 * i for i in range(count)]
    return [Option(i, *level) for i, level in enumerate(zip(sizes, qualities, saved, strict=True))]


@pytest.mark.parametrize("case", TABLE["ladders"], ids=lambda case: case["name"])
def test_undefined_cases_of_the_ladder(case):
    assert [p.index for p in Ladder.build(dense(*map(float, case["qualities"]))).options] == case["kept"]


@pytest.mark.parametrize(("levels", "options", "left"), [
    *((dense(34, 32, 30, 28, 26), {"min_quality": floor}, [0, 1, 2]) for floor in (29.0, 30.0)),  # 5: a slow slide
    (dense(34, 32, 30, 28, 26), {"min_quality": 30.5}, [0, 1]),
    # From 40 % on, 1.2 dB for 10 % after 2 dB for 40 %: a cliff; the same levels 10 % apart have none.
    (dense(40.0, 38.0, 36.8, saved=saved_shares([1000, 600, 500])), {}, [0, 1]),
    (dense(40.0, 38.0, 36.8), {}, [0, 1, 2]),
    # 4 dB for 40 %, 2 dB for 10 %: 1.2 dB per 10 % so far, of which 2.3 is no cliff; of 1 dB it would be one.
    (dense(40.0, 36.0, 34.0, 31.7, saved=[0.0, 0.4, 0.5, 0.6]), {}, [0, 1, 2, 3]),
    (dense(40, 39, 38, 37, sizes=[1000, 400, 700, 300]), {}, [0, 1, 3]),  # 9: sizes that do not fall
])  # fmt: skip
def test_what_is_left_above_the_floor_and_before_a_cliff(levels, options, left):
    assert [p.index for p in Ladder.build(levels, **options).options] == left


def test_what_levels_save():
    assert saved_shares([1000, 600, 500]) == pytest.approx([0, 0.4, 0.5])
    assert saved_shares([0, 0]) == [0, 0] and saved_shares([5, 9]) == [0, 0]


NOTHING_FITS = "nothing fits 10 B, taking the smallest"
NONE_FIT = Decision(1, False, "nothing fits 0 B, taking the smallest", 100)


@pytest.mark.parametrize(("qualities", "sizes", "budget", "expected"), [
    ((40, 39, 38, 37), [1000, 400, 700, 300], 500, Decision(1, True, "400 B fit 500 B", 400)),  # 9
    ((40, 39, 38, 20), None, 10, Decision(2, False, NOTHING_FITS, 200)),  # 7: with a cliff
    ((40, 39, 38), None, 10, Decision(2, False, NOTHING_FITS, 100)),  # 8: without one
    ((40, 39), [100, 0], -5, Decision(1, True, "0 B fit 0 B", 0)),  # 14: who sends nothing always fits
    *(((40, 39), None, budget, NONE_FIT) for budget in (math.nan, -1.0, -math.inf, 0.0)),  # 12: that are none
])  # fmt: skip
def test_the_best_that_fits_or_the_smallest(qualities, sizes, budget, expected):
    assert select(Ladder.build(dense(*qualities, sizes=sizes)), budget) == expected


def test_units_13_and_bandwidths_that_are_none_12():
    """8 Mbit/s at 25 fps are 40,000 bytes a frame; half of it spent, less a header."""
    assert (frame_budget(8e6, 25), frame_budget(0.8, 0.1)) == pytest.approx((40_000, 1.0))
    assert [frame_budget(bandwidth, 30) for bandwidth in (math.nan, -1.0, 0.0)] == [0.0] * 3


@pytest.mark.parametrize(("function", "arguments", "words"), [
    # 6
    *((partial(Ladder.build, beta=beta), [dense(40, 39)], "more than 1") for beta in (1.0, 0.5, 0.0, math.nan)),
    (Ladder.build, [[]], "at least one level"), (select_literal, [[], 10], "at least one level"),  # 10
    (Ladder.build, [dense(40, math.nan)], "level 1"),  # 11
    (frame_budget, [1e6, 0.0], "frame rate"),  # 12
])  # fmt: skip
def test_what_is_refused(function, arguments, words):
    with pytest.raises(ConfigError, match=words):
        function(*arguments)


@pytest.mark.parametrize("case", TABLE["printed"], ids=lambda case: case["name"])
def test_algorithm_1_as_printed(case):
    """Level 0 of the largest budget wherever the search finds something: it looks for the lowest that fits."""
    levels = dense(*map(float, case["qualities"]), sizes=case.get("sizes"))
    budget, beta = float(case.get("budget", "inf")), float(case.get("beta", 2.0))
    assert select_literal(levels, budget, beta) == case["answer"]


drawn = st.tuples(st.integers(0, 10_000), st.floats(0, 120) | st.just(math.inf))
points = st.lists(drawn, min_size=1, max_size=12).map(lambda rows: [Option(i, *p, 0.1 * i) for i, p in enumerate(rows)])


@given(points=points, budget=st.floats(allow_nan=True, allow_infinity=True), beta=st.floats(1.01, 100))
def test_selection_is_total_and_keeps_its_word(points, budget, beta):
    ladder = Ladder.build(points, beta=beta)
    decision = select(ladder, budget)
    assert decision.index in [p.index for p in ladder.options]
    usable = budget if budget > 0 else 0.0
    assert decision.fits == any(p.size_bytes <= usable for p in ladder.options)
    assert not decision.fits or decision.size_bytes <= usable
    assert decision.size_bytes == points[decision.index].size_bytes


@given(points=points, budget=st.integers(0, 12_000))
def test_without_a_cliff_ladders_fall_strictly_and_the_best_that_fits_is_taken(points, budget):
    """The paper's ILP separates by frame: the optimum is the best quality among what fits."""
    ladder = Ladder.build(points, beta=math.inf, cliff_db=math.inf)
    for better, worse in itertools.pairwise(ladder.options):
        assert better.size_bytes > worse.size_bytes and better.quality > worse.quality
    for p in points:  # whatever was left out is beaten or equalled by something kept
        assert any(r.size_bytes <= p.size_bytes and r.quality >= min(p.quality, 100) for r in ladder.options)
    fitting = [min(p.quality, 100.0) for p in points if p.size_bytes <= budget]
    if fitting:
        assert min(points[select(ladder, budget).index].quality, 100.0) == max(fitting)


@given(qualities=st.lists(st.floats(20, 60), min_size=1, max_size=11, unique=True), budget=st.integers(0, 1200))
def test_as_printed_and_as_defined_agree_where_algorithm_1_is_defined(qualities, budget):
    """Falling quality and sizes, no cliff, something fits."""
    points = dense(*sorted(qualities, reverse=True))
    answer = select_literal(points, budget, beta=math.inf)
    decision = select(Ladder.build(points, beta=math.inf, cliff_db=math.inf), budget)
    assert (answer is not None) == decision.fits
    assert answer is None or answer == decision.index
