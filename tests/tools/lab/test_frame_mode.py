"""The paper's frame mode and its integer programme, by hand."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from airgs_codec.errors import ConfigError, TransportError
from airgs_codec.play.ladder import Ladder, Option, select
from airgs_codec.play.offers import Offers
from airgs_codec.play.trace import Link, Trace
from tests.support.manifests import tiny_manifest
from tools.lab.paper.frames import (
    CHOOSERS,
    NOTHING,
    SKIPPED,
    choose_top,
    frame_options,
    frame_programme,
    frame_table,
    paper_programme,
    push_frames,
    simulate_frames,
    time_percentiles,
)
from tools.lab.paper.streaming import page

CATALOGUE = Offers(tiny_manifest())  # 10 fps; state 200, 100, 50 B a frame and 10 B of sidecar


def link(rates, starts=None):
    starts = list(range(len(rates))) if starts is None else starts
    return Link(Trace("t", np.array(starts, float), np.array(rates, float), 1000.0))


def test_what_a_frame_weighs():
    levels = frame_options(CATALOGUE, keys=False)
    assert len(levels) == 20 and [p.size_bytes for p in levels[0]] == [210, 110, 60]
    assert [p.quality for p in levels[0]] == [40, 38, 34]
    with_keys = frame_options(CATALOGUE, keys=True)
    assert [p.size_bytes for p in with_keys[0]] == [630, 530, 480]  # 4200 B of keys over ten frames


def test_a_constant_link():
    """1250 B/s: 125 B a frame. Level 1 takes 88 ms, level 0 168 ms and holds up what follows."""
    best = simulate_frames(CATALOGUE, link([1e4]), "paper", 1)
    assert set(best.levels) == {1} and best.fits.all() and not best.late.any()
    assert best.sent_s == pytest.approx(np.full(20, 0.088)) and best.paper_s == pytest.approx(best.sent_s)
    top = simulate_frames(CATALOGUE, link([1e4]), "unpruned", 1)
    assert top.sent_s == pytest.approx(np.full(20, 0.168)) and top.late.all()
    assert top.waited_s == pytest.approx(0.068 * np.arange(20))
    least = simulate_frames(CATALOGUE, link([1e4]), "pruned", 1)
    assert set(least.levels) == {2}


def test_nothing_fits_an_outage():
    rates = link([1e4, 0, 1e4], [0, 0.5, 1.0])
    best, literal = (simulate_frames(CATALOGUE, rates, name, 1) for name in ("paper", "paper-literal"))
    assert best.levels.tolist() == [1] * 5 + [SKIPPED] * 5 + [1] * 10
    assert best.sizes[5:10].sum() == 0 and np.isnan(best.quality[5:10]).all()
    assert np.isinf(literal.paper_s[5:10]).all() and literal.waited_s.max() > 0.4
    table = frame_table(best)
    assert table["skipped"] == table["infeasible"] == 0.25 and table["late"] == 0
    assert table["worst_ms"] == pytest.approx(88) and table["kb_frame"] == pytest.approx(0.0825)
    assert frame_table(literal)["outage"] == 0.25


def test_the_cliff_acts_before_the_search():
    """38 dB after 40 at half the bytes, then 34: twice the drop for half the saving is past the cliff.

    825 B/s carry 82 B a frame, which only the level past the cliff is small enough for.
    """
    slow = link([6600])
    names = ("paper", "paper-no-cliff", "paper-literal", "paper-literal-no-cliff")
    levels = {name: set(simulate_frames(CATALOGUE, slow, name, 1).levels.tolist()) for name in names}
    assert levels == {"paper": {SKIPPED}, "paper-no-cliff": {2}, "paper-literal": {2}, "paper-literal-no-cliff": {2}}
    c = Offers(tiny_manifest(psnr=((40.0, 36.0), (38.0, 35.0), (32.0, 32.0))))  # as printed: 6 dB after 2
    nothing = link([10.0])
    printed = [simulate_frames(c, nothing, name, 1).levels[0] for name in names[2:]]
    assert printed == [2, 2]  # the cliff's level where nothing fits, and the last where that is undefined


def frames(*sizes, psnr=40.0):
    """Frames of a method without levels."""
    return [(Option(0, size, psnr - n, 0.0),) for n, size in enumerate(sizes)]


def test_what_stands_on_the_screen():
    """1000 B/s, 10 fps: 100 B a frame. The second takes 0.24 s, so that it and two more are late."""
    log = push_frames(frames(50, 240, 40, 40, 40, 0), 10.0, link([8e3]), choose_top)
    assert log.late.tolist() == [False, True, True, True, False, False]
    assert log.shown.tolist() == [0, 0, 0, 2, 4, 5]
    table = frame_table(log)
    assert table["psnr"] == pytest.approx(37.5) and table["skipped"] == table["blank"] == 0
    assert table["psnr_screen"] == pytest.approx((40 + 40 + 40 + 38 + 36 + 35) / 6) and table["stale"] == 0.5
    known = frame_table(log, lambda stands, due: 20.0 + stands)
    assert known["psnr_screen"] == pytest.approx((40 + 20 + 20 + 22 + 36 + 35) / 6)


def test_a_frame_that_takes_its_time_to_the_last_bit_is_not_late():
    """Sums of times are rounded: without a tolerance some of these frames missed theirs by 1e-15 s."""
    log = push_frames([(Option(0, 1000, 40.0, 0.0),)] * 300, 29.97, link([8e3 * 29.97]), choose_top)
    assert not log.late.any() and (log.shown == np.arange(300)).all()


def test_before_anything_has_come_nothing_stands():
    log = push_frames(frames(50, 60), 10.0, link([0, 8e3], [0, 0.1]), choose_top)
    assert log.shown.tolist() == [NOTHING, 0]
    assert frame_table(log)["blank"] == 0.5 and frame_table(log)["psnr_screen"] == pytest.approx(40.0)
    nothing = frame_table(simulate_frames(CATALOGUE, link([10.0]), "paper", 1))
    assert nothing["skipped"] == nothing["blank"] == 1
    assert np.isnan([nothing["psnr"], nothing["psnr_screen"], nothing["worst_ms"]]).all()


def test_a_stream_without_levels_is_timed_as_the_paper_times_it():
    log = push_frames(frames(*range(0, 101)), 10.0, link([8e3]), choose_top)
    table = frame_table(log)
    assert time_percentiles([log]) == pytest.approx(range(101), abs=1)
    assert (table["mean_ms"], table["p95_ms"], table["worst_ms"]) == pytest.approx((50, 95, 100))


def test_a_frame_that_is_skipped_never_came():
    """Four of ten frames fit: the distribution of times over all frames ends there."""
    log = push_frames(frames(*[50] * 4, *[500] * 6), 10.0, link([8e3]), CHOOSERS["paper-no-cliff"])
    times = time_percentiles([log])
    assert (log.levels == SKIPPED).sum() == 6
    assert times[1:41] == pytest.approx([50.0] * 40) and np.isinf(times[41:]).all()


def test_the_papers_programme_is_what_each_frame_alone_chooses():
    rates = link([1e4, 2e4, 0, 6e3], [0, 0.5, 1.0, 1.5])
    best = frame_programme(frame_options(CATALOGUE, False), CATALOGUE.fps, rates)
    greedy = simulate_frames(CATALOGUE, rates, "paper-no-cliff", 1)
    assert best["psnr"] == pytest.approx(np.nanmean(greedy.quality)) and best["infeasible"] == 0.25
    assert best["solve_s"] >= 0
    shares, feasible = paper_programme([[60]], [[34.0]], [50.0])
    assert shares.tolist() == [[0]] and feasible.tolist() == [False]
    assert np.isnan(frame_programme(frame_options(CATALOGUE, False), CATALOGUE.fps, link([10.0]))["psnr"])


def test_an_estimated_rate_recovers_after_an_outage():
    log = simulate_frames(CATALOGUE, link([1e5, 0, 1e5], [0, 0.5, 0.8]), "paper", 4, known=False)
    assert log.levels[0] == SKIPPED  # nothing is known yet
    assert (log.levels[-20:] == 0).all()


def test_what_cannot_be_played():
    with pytest.raises(ConfigError, match="expected unpruned"):
        simulate_frames(CATALOGUE, link([1e4]), "best", 1)
    with pytest.raises(ConfigError, match="at least one frame"):
        push_frames([], 10.0, link([1e4]), choose_top)
    with pytest.raises(ConfigError, match="more than 0, got 0"):
        push_frames(frame_options(CATALOGUE, False), 0.0, link([1e4]), choose_top)
    with pytest.raises(TransportError, match="would take inf s"):
        simulate_frames(CATALOGUE, link([1e-20]), "unpruned", 1)
    with pytest.raises(ConfigError, match="no measured quality"):
        simulate_frames(Offers(tiny_manifest(psnr=None)), link([1e4]), "paper", 1)


@settings(deadline=None, max_examples=40)
@given(
    frames=st.lists(
        st.lists(st.tuples(st.integers(0, 5000), st.floats(20, 60)), min_size=3, max_size=3), min_size=1, max_size=6
    ),
    budgets=st.lists(st.floats(0, 6000), min_size=6, max_size=6),
)
def test_the_papers_programme_separates_by_frame(frames, budgets):
    sizes = [[s for s, _ in levels] for levels in frames]
    qualities = np.array([[q for _, q in levels] for levels in frames])
    shares, feasible = paper_programme(sizes, qualities, budgets[: len(frames)])
    alone = 0.0
    for levels, budget, fits in zip(frames, budgets, feasible, strict=False):
        points = [Option(j, s, q, 0.1 * j) for j, (s, q) in enumerate(levels)]
        decision = select(Ladder.build(points, beta=math.inf, cliff_db=math.inf), budget)
        assert decision.fits == fits
        alone += levels[decision.index][1] if fits else 0.0
    assert (shares * qualities).sum() == pytest.approx(alone, abs=1e-6)


def test_the_papers_programme_takes_sizes_over_nine_decades():
    sizes = [[10.0**k, 0.5 * 10.0**k] for k in range(10)]
    shares, feasible = paper_programme(sizes, [[40.0, 30.0]] * 10, [10.0**k for k in range(10)])
    assert feasible.all() and shares[:, 0] == pytest.approx(np.ones(10))


def test_the_papers_programme_saves_no_bytes_for_later():
    """What a plan over two segments does (tests/play/test_bound.py): the first leaves bytes for the second."""
    shares, feasible = paper_programme([[6300, 5300, 3800]] * 2, [[40, 38, 36]] * 2, [6300, 5300])
    assert feasible.all() and shares.argmax(axis=1).tolist() == [0, 1]


def test_the_page_has_a_row_for_each_way_to_choose():
    rates = link([1e4])
    runs = [{"chooser": n} | frame_table(simulate_frames(CATALOGUE, rates, n, 1)) for n in CHOOSERS]
    made = page(runs, [frame_programme(frame_options(CATALOGUE, False), CATALOGUE.fps, rates)])
    (section,) = made.sections
    assert [row["chooser"] for row in section.tables[0].rows] == list(CHOOSERS)
    assert "integer programme (eq. 13) has 38.00 dB" in section.answer and "alone 38.00 dB" in section.answer
