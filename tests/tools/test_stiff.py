"""The tool that looks for where things become unstable: how it judges, what it keeps, what it says."""

import json
import math

import numpy as np
import pytest

from airgs_codec.errors import SceneError
from tools import stiff
from tools.stiffness.gradients import relative_errors
from tools.stiffness.kept import sweep_once
from tools.stiffness.outcome import (
    BOUNDED,
    CONVERGES,
    DIVERGES,
    NOT_FINITE,
    REFUSED,
    Cell,
    Sweep,
    attempt,
    error_end,
    fit_end,
    regions,
)
from tools.stiffness.page import conclusion, write_page
from tools.stiffness.scenes import AXES, needles, quaternions_of
from tools.stiffness.steps import LIMIT, judge_factors, spread_slopes, unlimited


def sweep(*cells: Cell) -> Sweep:
    return Sweep("a", "Title", "x", "y", "loss", ("ours", "1"), "nothing", cells)


@pytest.mark.parametrize(
    ("before", "after", "end"),
    [
        (1.0, 0.4, CONVERGES),
        (1.0, 0.6, BOUNDED),
        (1.0, 1.04, BOUNDED),
        (1.0, 1.2, DIVERGES),
        (1e-6, 5e-5, BOUNDED),  # no picture shows it
        (1e-6, 5e-4, DIVERGES),
        (0.0, 0.0, BOUNDED),
        (1.0, math.nan, NOT_FINITE),
        (1.0, math.inf, NOT_FINITE),
    ],
)
def test_how_a_fit_ends(before: float, after: float, end: str) -> None:
    assert fit_end(before, after, True) == end
    assert fit_end(before, after, False) == NOT_FINITE


def test_errors_are_close_or_bounded_or_not_finite() -> None:
    assert [error_end(e, 1e-3) for e in (0.0, 1e-3, 0.5, math.nan)] == [CONVERGES, CONVERGES, BOUNDED, NOT_FINITE]


def test_a_refusal_is_an_end_and_a_fault_of_the_program_is_not() -> None:
    def refused() -> tuple[str, float, str]:
        raise SceneError("expected this, got that")

    cell = attempt("ours", "1", 2.0, refused)
    assert (cell.end, cell.note) == (REFUSED, "expected this, got that") and math.isnan(cell.value)
    with pytest.raises(ZeroDivisionError):
        attempt("ours", "1", 2.0, lambda: (CONVERGES, 1 / 0, ""))


def test_neighbours_of_one_end_are_a_region_of_the_code_as_it_is() -> None:
    ends = [CONVERGES, CONVERGES, BOUNDED, CONVERGES]
    cells = [Cell("ours", "1", float(i), end, 0.1 * i, "note" * (end == BOUNDED)) for i, end in enumerate(ends)]
    others = [Cell("ours", "10", 0.0, DIVERGES, 9.0), Cell("theirs", "1", 0.0, DIVERGES, 9.0)]
    found = sweep(*cells, *others)
    assert [(r.first, r.last, r.end, r.notes) for r in regions(found)] == [
        (0, 1, CONVERGES, ""),
        (2, 2, BOUNDED, "note"),
        (3, 3, CONVERGES, ""),
    ]
    words = conclusion(found)
    assert words.startswith("3 of 4 converge (x 0 to 1, 3), loss at most 0.3, 1 of 4 are bounded (x 2)")
    assert "0 of 1 fields of “theirs” converge, 1 diverge (against 3 of 5 of “ours”)" in words


def test_the_page_counts_faults() -> None:
    found = sweep(Cell("ours", "1", 1.0, CONVERGES, 0.1), Cell("ours", "1", 2.0, NOT_FINITE, math.nan))
    page = write_page({"trainer": [found]}, {"trainer": "a.png"}, "Made.")
    assert "Of 2 experiments with the code as it is, 1 converge, 1 are not finite; 1 are faults." in page
    assert "|  | 2 | is not finite |  |  |" in page and "![How the cells of the trainer end](a.png)" in page


def test_a_finished_sweep_is_kept_and_a_broken_file_is_made_anew(tmp_path) -> None:
    made = []

    def make() -> Sweep:
        made.append(1)
        return sweep(Cell("ours", "1", 1.0, REFUSED, math.nan, "why"))

    first, seconds = sweep_once(tmp_path, "a", "whole", make)
    again, same = sweep_once(tmp_path, "a", "whole", make)
    assert made == [1] and same == seconds and repr(again) == repr(first)
    sweep_once(tmp_path, "a", "quick", make)
    assert len(made) == 2
    (tmp_path / "a.json").write_text(json.dumps({"variant": "quick", "sweep": {}}))
    sweep_once(tmp_path, "a", "quick", make)
    assert len(made) == 3


def test_an_unknown_part_is_one_line(tmp_path, capsys) -> None:
    assert stiff.main(["-o", str(tmp_path), "--only", "codec,kitchen"]) == 2
    assert capsys.readouterr().err == "stiff: expected parts trainer, gradients, codec, selector, got kitchen\n"


def test_every_sweep_has_a_name_of_its_own() -> None:
    names = [name for sweeps in stiff.parts().values() for name in sweeps]
    assert len(set(names)) == len(names) > 15


def test_factors_are_the_optimum_or_limited_or_without_limit() -> None:
    slopes = spread_slopes("one hardly matters", 12)
    ideal = unlimited(slopes)
    assert max(ideal.values()) / min(ideal.values()) == pytest.approx(1e6)
    assert judge_factors(ideal, ideal)[0] == DIVERGES
    assert judge_factors(dict.fromkeys(ideal, 1.0), ideal)[0] == BOUNDED
    even = unlimited(spread_slopes("evenly spread", 0))
    assert judge_factors(even, even)[:2] == (CONVERGES, pytest.approx(1))
    assert judge_factors({"grid": math.inf}, {"grid": 1.0})[0] == NOT_FINITE
    assert pytest.approx(7.14, abs=0.01) == LIMIT


def test_scenes_have_the_property_that_they_are_named_for() -> None:
    g = needles(1e6).target
    assert np.exp(g.log_scales.max() - g.log_scales.min()) == pytest.approx(1e6, rel=1e-3)
    lengths = np.linalg.norm(quaternions_of(1e-6).target.quaternions.astype(np.float64), axis=1)
    np.testing.assert_allclose(lengths, 1e-6, rtol=1e-5)
    for axis in AXES:
        problem = axis.make(axis.values[-1])
        assert all(np.isfinite(getattr(problem.start, name)).all() for name in problem.start.__slots__)


def test_gradients_of_round_and_of_long_gaussians_are_those_of_the_definition() -> None:
    for ratio in (1.0, 100.0):
        problem = needles(ratio)
        camera = problem.cameras[0]
        pull = np.random.default_rng(0).normal(size=(camera.height, camera.width, 3)).astype(np.float32)
        assert max(relative_errors(problem.start, camera, pull)) < 1e-3
