"""Canonical means are within half a cell of where they were."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from airgs_codec.coding.grid import cell_bits, fit_grid, grid_codes, grid_means
from airgs_codec.package.tables import Grid


@given(
    npst.arrays(np.float32, st.tuples(st.just(20), st.just(3)), elements=st.floats(-1e6, 1e6, width=32)),
    npst.arrays(np.int16, 20, elements=st.integers(-128, 127)),
    st.floats(1e-6, 1e6),
)
def test_means_are_within_half_a_cell_of_their_class(means, classes, cell):
    grid = fit_grid(means, classes, cell)
    assert grid.bits <= 21 and grid.step == cell * 2.0**grid.finest
    side = grid.step * 2.0 ** cell_bits(classes, grid)
    error = np.abs(grid_means(grid_codes(means, classes, grid), classes, grid) - means).max(axis=1)
    assert (error <= side / 2 * (1 + 1e-9) + np.spacing(np.abs(means).max())).all()


def test_cells_of_a_class_are_two_to_the_class_wide():
    means = np.array([[0, 0, 0], [10, 10, 10], [3.3, 7.7, 9.9]], np.float32)
    classes = np.array([-1, 2, 1], np.int16)
    grid = fit_grid(means, classes, 0.5)
    assert grid == Grid([0.0, 0.0, 0.0], 0.25, 6, -1)
    np.testing.assert_array_equal(cell_bits(classes, grid), [0, 3, 2])
    middles = grid_means(grid_codes(means, classes, grid), classes, grid)
    np.testing.assert_array_equal(middles, [[0.125] * 3, [11] * 3, [3.5, 7.5, 9.5]])
