"""Canonical means are within half a cell of where they were, in every key quality; cells are nested."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from airgs_codec.coding.grid import cell_bits, coarse_codes, fit_grid, grid_codes, grid_means
from tests.faces import Grid


@given(
    npst.arrays(np.float32, st.tuples(st.just(20), st.just(3)), elements=st.floats(-1e6, 1e6, width=32)),
    npst.arrays(np.int16, 20, elements=st.integers(-128, 127)),
    st.floats(1e-6, 1e6),
    st.integers(0, 21),
)
def test_means_are_within_half_a_cell_of_their_class(means, classes, cell, coarser):
    grid = fit_grid(means, classes, cell)
    assert grid.unit == cell
    codes, wider = grid_codes(means, classes, grid)
    side = grid.step * 2.0**wider * 2.0 ** cell_bits(classes - wider, grid, coarser)
    error = np.abs(grid_means(codes, classes, wider, grid, coarser) - means).max(axis=1)
    assert (error <= side / 2 * (1 + 1e-9) + np.spacing(np.abs(means).max())).all()


@pytest.mark.parametrize("far", [1e4, 1e9, 1e30])
def test_far_rows_are_as_near_as_they_can_be_told_and_change_nothing_of_others(far):
    means = np.random.default_rng(0).normal(size=(100, 3)).astype(np.float32)
    means[:5] = far * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 1], [1, -1, 1], [0, 0, -1]], np.float32)
    classes = np.zeros(100, np.int16)
    grid = fit_grid(means, classes, 1e-5)
    codes, wider = grid_codes(means, classes, grid)
    assert grid == fit_grid(means[5:], classes[5:], 1e-5) and not wider[5:].any()
    assert (np.abs(grid_means(codes, classes, wider, grid) - means)[:5].max(axis=1) <= 2.0**-20 * far).all()


def test_cells_of_a_class_are_two_to_the_class_wide():
    means = np.array([[0, 0, 0], [10, 10, 10], [3.3, 7.7, 9.9]], np.float32)
    classes = np.array([-1, 2, 1], np.int16)
    grid = fit_grid(means, classes, 0.5)
    assert grid == Grid([0, 0, 0], 0.25, -1)
    np.testing.assert_array_equal(cell_bits(classes, grid), [0, 3, 2])
    codes, wider = grid_codes(means, classes, grid)
    for coarser, middles in ((0, [[0.125] * 3, [11] * 3, [3.5, 7.5, 9.5]]), (1, [[0.25] * 3, [10] * 3, [3, 7, 9]])):
        np.testing.assert_array_equal(grid_means(codes, classes, wider, grid, coarser), middles)
    np.testing.assert_array_equal(grid_means(codes, classes, wider, grid, 21), [[2.0**18] * 3] * 3)  # are one cell


@given(
    npst.arrays(np.uint64, 20, elements=st.integers(0, 2**63 - 1)),
    npst.arrays(np.int16, 20, elements=st.integers(-3, 30)),
    st.integers(0, 21),
    st.integers(0, 21),
)
def test_the_cells_of_a_quality_lie_in_those_of_coarser_ones(codes, classes, a, b):
    grid, wider = Grid([0, 0, 0], 1.0, 0), np.zeros(20, np.int16)
    fine, coarse = min(a, b), max(a, b)
    inner = coarse_codes(codes, classes, grid, fine)
    np.testing.assert_array_equal(
        coarse_codes(inner, classes, grid, coarse), coarse_codes(codes, classes, grid, coarse)
    )
    middles = [grid_means(inner, classes, wider, grid, r) for r in (fine, coarse)]
    apart = np.abs(middles[0] - middles[1]).max(axis=1)
    sides = [2.0 ** cell_bits(classes, grid, r) for r in (fine, coarse)]
    assert (apart <= (sides[1] - sides[0]) / 2).all()
