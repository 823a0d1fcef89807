"""Stiff cases: how an experiment is judged, where regions lie, what the page says."""

import math
from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.errors import SceneError
from tools.lab import main, published
from tools.lab.command import Lab
from tools.lab.numerics import stiff
from tools.lab.numerics.fits import TRAINER, fit
from tools.lab.numerics.gradients import relative_errors
from tools.lab.numerics.outcome import (
    BOUNDED,
    DIVERGES,
    EXACT,
    NOT_FINITE,
    REFUSED,
    UNFIT,
    Case,
    Cell,
    attempt,
    does_well,
    error_end,
    fit_end,
    grid,
    ranges,
)
from tools.lab.numerics.problems import AXES, faint_or_opaque, needles, quaternions_of
from tools.lab.numerics.steps import LIMIT, judge_factors, spread_slopes, unlimited
from tools.lab.page import text_of, write_picture


@pytest.mark.parametrize(
    ("before", "after", "end"),
    [
        (1.0, 5e-5, EXACT),
        (1.0, 2e-4, BOUNDED),
        (1.0, 0.6, BOUNDED),
        (1.0, 1.04, BOUNDED),
        (1.0, 1.2, DIVERGES),
        (1e-6, 5e-5, EXACT),  # no picture shows it
        (1e-6, 5e-4, DIVERGES),
        (0.0, 0.0, EXACT),
        (1.0, math.nan, NOT_FINITE),
        (1.0, math.inf, NOT_FINITE),
    ],
)
def test_how_a_fit_ends(before, after, end):
    assert fit_end(before, after, True) == end
    assert fit_end(before, after, False) == NOT_FINITE


def test_what_cannot_be_fitted_is_not_called_bounded():
    """Rows too faint to be drawn have no gradient: nothing moves, and the picture stays wrong."""
    end, left, words = fit(faint_or_opaque(-30.0), lambda adam: adam, 1.0, iterations=2)
    assert (end, left, words) == (UNFIT, 1.0, "nothing moves")


def test_errors_are_close_or_bounded_or_not_finite():
    assert [error_end(e, 1e-3) for e in (0.0, 1e-3, 0.5, math.nan)] == [EXACT, EXACT, BOUNDED, NOT_FINITE]


def test_a_refusal_is_an_end_and_a_fault_of_the_program_is_not():
    def refused(panel, row, x):
        raise SceneError("expected this, got that")

    end, value, note = attempt(refused, ("ours", "1", 2.0))
    assert (end, note) == (REFUSED, "expected this, got that") and math.isnan(value)
    with pytest.raises(ZeroDivisionError):
        attempt(lambda panel, row, x: (EXACT, 1 / 0, ""), ("ours", "1", 2.0))


CASE = Case(
    "trainer", "a", "Title", "x", "loss", (TRAINER, "1"), grid([TRAINER], "1", (0.0, 1.0, 2.0, 3.0)),
    lambda panel, row, x: (BOUNDED if x == 2 else EXACT, x, ""), "a limit of {span}",
)  # fmt: skip


def test_neighbours_of_one_end_are_a_range_of_the_code_as_it_is():
    other = Cell("a", TRAINER, "10", 0.0, DIVERGES, 9.0)
    own = CASE.shipped([*CASE.run(), other])
    assert (ranges(own, does_well), ranges(own, lambda cell: cell.end == BOUNDED)) == ("0 to 1, 3", "2")
    assert [cell.x for cell in CASE.run(quick=True)] == [0.0, 3.0]


def test_a_line_says_what_happens_and_what_to_do():
    line = stiff.Line("Things", ("a",), "keep x at {well}")
    unfit = Cell("a", TRAINER, "1", 4.0, UNFIT, 1.0, "nothing moves")
    row = stiff.row_of(line, [CASE], [*CASE.run(), unfit])
    assert row[stiff.HAPPENS] == "exact (3); bounded by a limit of 2 (1); does not fit: nothing moves (1)"
    assert row["what to do"] == "keep x at 0 to 1, 3"
    assert stiff.row_of(replace(line, names=("b",)), [CASE], CASE.run()) == {}


def test_ten_lines_hold_every_case():
    named = [name for line in stiff.LINES for name in line.names]
    assert len(stiff.LINES) == 10 and sorted(named) == sorted(case.name for case in stiff.CASES)


@pytest.mark.parametrize(
    ("end", "words", "failed"), [(BOUNDED, "none diverges", False), (NOT_FINITE, "1 diverge", True)]
)
def test_a_fault_is_told(monkeypatch, end, words, failed):
    monkeypatch.setattr(stiff, "CASES", (CASE,))
    made = stiff.page([*CASE.run()[:2], Cell("a", TRAINER, "1", 2.0, end, math.nan, "why")])
    assert made.failed == failed and words in text_of(made).replace("\n", " ")


def test_a_page_draws_maps_of_its_cells(tmp_path, monkeypatch):
    monkeypatch.setattr(stiff, "CASES", (CASE,))
    made = stiff.page(CASE.run())
    write_picture(made.sections[1].pictures[0], tmp_path / "map.png")
    assert 2_000 < (tmp_path / "map.png").stat().st_size < 100_000


def test_every_conclusion_of_the_documents_follows_from_their_figures():
    entry = published.read_figures()["stiff"]
    cells = [
        Cell(**row | {"value": math.nan if row["value"] is None else row["value"]}) for row in rows(entry, "stiff")
    ]
    made = stiff.page(cells)
    assert not made.failed and [s.answer for s in made.sections if s.answer] == entry["answers"]
    assert [list(row.values()) for row in made.sections[0].tables[0].rows] == entry["tables"]["stiff-lines"]["rows"]


def rows(entry, name):
    table = entry["tables"][name]
    return [dict(zip(table["columns"], row, strict=True)) for row in table["rows"]]


def test_what_is_finished_is_not_tried_again(tmp_path, monkeypatch):
    tried = []
    case = replace(CASE, judge=lambda *at: tried.append(at) or (EXACT, 0.0, ""))
    monkeypatch.setattr(stiff, "CASES", (case,))
    for _ in range(2):
        stiff.run(stiff.Options(only=("trainer",)), Lab.at(tmp_path, quiet=True))
    assert len(tried) == 4


def test_an_unknown_part_is_one_line(tmp_path, capsys):
    assert main(["stiff", "-o", str(tmp_path), "--only", "codec", "kitchen"]) == 2
    expected = "lab stiff: --only: expected some of trainer, gradients, codec, selector, got kitchen\n"
    assert capsys.readouterr().err == expected


def test_every_case_has_a_name_of_its_own_and_what_limits_it():
    names = [case.name for case in stiff.CASES]
    assert len(set(names)) == len(names) > 15
    for case in stiff.CASES:
        panels, rows = {panel for panel, _, _ in case.points}, {row for _, row, _ in case.points}
        assert case.own[0] in panels and (case.own[1] in rows or not case.own[1])


def test_factors_are_the_optimum_or_limited_or_without_limit():
    slopes = spread_slopes("one hardly matters", 12)
    ideal = unlimited(slopes)
    assert max(ideal.values()) / min(ideal.values()) == pytest.approx(1e6)
    assert judge_factors(ideal, ideal)[0] == DIVERGES
    assert judge_factors(dict.fromkeys(ideal, 1.0), ideal)[0] == BOUNDED
    even = unlimited(spread_slopes("evenly spread", 0))
    assert judge_factors(even, even)[:2] == (EXACT, pytest.approx(1))
    assert judge_factors({"grid": math.inf}, {"grid": 1.0})[0] == NOT_FINITE
    assert pytest.approx(7.14, abs=0.01) == LIMIT


def test_scenes_have_the_property_that_they_are_named_for():
    g = needles(1e6).target
    assert np.exp(g.log_scales.max() - g.log_scales.min()) == pytest.approx(1e6, rel=1e-3)
    lengths = np.linalg.norm(quaternions_of(1e-6).target.quaternions.astype(np.float64), axis=1)
    np.testing.assert_allclose(lengths, 1e-6, rtol=1e-5)
    for axis in AXES:
        problem = axis.make(axis.values[-1])
        assert all(np.isfinite(getattr(problem.start, name)).all() for name in problem.start.__slots__)


def test_gradients_of_round_and_of_long_gaussians_are_those_of_the_definition():
    for ratio in (1.0, 100.0):
        problem = needles(ratio)
        camera = problem.cameras[0]
        pull = np.random.default_rng(0).normal(size=(camera.height, camera.width, 3)).astype(np.float32)
        assert max(relative_errors(problem.start, camera, pull)) < 1e-3
