"""Columns of whole numbers come back exactly, in few bytes, and so do positions in cells, in every keyframe quality.

What is refused is in the vectors (tests/vectors).
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from airgs_codec.coding import rangecoder, sidecar
from airgs_codec.coding.rangecoder import ColumnReader, encode_columns, sum_gaps
from airgs_codec.coding.sidecar import cell_bits, coarse_codes, fit_grid, grid_codes, grid_means
from tests.faces import FormatError, Grid

MOST = (1 << 63) - 1
GRID = Grid([0, 0, 0], 1.0, 0)
numbers = npst.arrays(np.int64, st.integers(0, 60), elements=st.one_of(st.integers(0, 9), st.integers(0, MOST)))


@given(st.lists(st.tuples(numbers, st.sampled_from([0, 1])), max_size=4))
def test_coded_columns_are_exact(written):
    reader = ColumnReader(encode_columns(written), "x")
    for values, order in written:
        np.testing.assert_array_equal(reader.column(len(values), order), values)
    reader.close()


def test_columns_longer_than_a_batch_are_near_their_entropy_order_1_profits_and_negative_numbers_are_refused():
    values = np.random.default_rng(3).geometric(0.3, 100_000)
    coded = encode_columns([(values, 0)])
    np.testing.assert_array_equal(ColumnReader(coded, "x").column(len(values), 0), values)
    share = 0.3 * 0.7 ** (np.arange(1, 60) - 1)
    assert 8 * len(coded) / len(values) < 1.03 * -(share * np.log2(share)).sum()
    walk = np.random.default_rng(3).integers(0, 2, 5000).cumsum() // 100 % 9
    assert len(encode_columns([(walk, 1)])) < 0.5 * len(encode_columns([(walk, 0)]))
    with pytest.raises(ValueError, match="-1"):
        encode_columns([(np.array([3, -1]), 0)])


def test_compiled_loops_give_the_bytes_and_numbers_of_plain_ones(monkeypatch):
    rng = np.random.default_rng(5)
    wide = rng.integers(0, 1 << 62, 500) >> rng.integers(0, 62, 500)
    columns = [(wide, 0), (rng.geometric(0.3, rangecoder._BATCH + 9), 1), (np.full(3, MOST), 1), (np.empty(0, int), 0)]
    gaps, low = rng.integers(0, 9, 500), 3 * rng.integers(0, 3, 500)
    found, compiles = [], rangecoder._compiled
    assert compiles(rangecoder._decode) is not None
    for compiled in (False, True):
        monkeypatch.setattr(rangecoder, "LOADING", 0 if compiled else 1 << 62)
        monkeypatch.setattr(rangecoder, "_compiled", compiles if compiled else lambda loop: None)
        coded = encode_columns(columns)
        reader = ColumnReader(coded, "x")
        read = [reader.column(len(values), order) for values, order in columns]
        reader.close()
        assert all(np.array_equal(a, b) for a, (b, _) in zip(read, columns, strict=True))
        with pytest.raises(FormatError, match="got the end"):
            ColumnReader(coded[: len(coded) // 2], "x").column(len(wide) + len(columns[1][0]), 0)
        found.append((coded, sum_gaps(gaps, low, 63), sum_gaps(gaps, low, 4)))
    assert found[0][0] == found[1][0] and np.array_equal(found[0][1], found[1][1])
    assert found[0][2] is None and found[1][2] is None


@given(
    npst.arrays(np.float32, st.tuples(st.just(20), st.just(3)), elements=st.floats(-1e6, 1e6, width=32)),
    npst.arrays(np.int16, 20, elements=st.integers(-128, 127)),
    st.floats(1e-6, 1e6),
    st.integers(0, 21),
)
def test_means_are_within_half_a_cell_of_their_class_in_every_keyframe_quality(means, classes, cell, coarser):
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
    far = [[2.0**18] * 3] * 3  # all are in one cell
    middles = {0: [[0.125] * 3, [11] * 3, [3.5, 7.5, 9.5]], 1: [[0.25] * 3, [10] * 3, [3, 7, 9]], 21: far}
    for coarser, expected in middles.items():
        np.testing.assert_array_equal(grid_means(codes, classes, wider, grid, coarser), expected)


@given(
    npst.arrays(np.uint64, 20, elements=st.integers(0, 2**63 - 1)),
    npst.arrays(np.int16, 20, elements=st.integers(-3, 30)),
    st.tuples(st.integers(0, 21), st.integers(0, 21)).map(sorted),
)
def test_the_cells_of_a_quality_lie_in_those_of_coarser_ones(codes, classes, qualities):
    grid, wider, (fine, coarse) = GRID, np.zeros(20, np.int16), qualities
    inner, outer = (coarse_codes(codes, classes, grid, r) for r in (fine, coarse))
    np.testing.assert_array_equal(coarse_codes(inner, classes, grid, coarse), outer)
    middles = [grid_means(inner, classes, wider, grid, r) for r in (fine, coarse)]
    apart = np.abs(middles[0] - middles[1]).max(axis=1)
    sides = [2.0 ** cell_bits(classes, grid, r) for r in (fine, coarse)]
    assert (apart <= (sides[1] - sides[0]) / 2).all()


@given(st.data())
def test_keyframe_sidecars_and_depths_alone_are_exact(data):
    n = data.draw(st.integers(1, 40))
    grid = Grid([0, 0, 0], 1.0, data.draw(st.integers(-128, 127)))
    classes = data.draw(npst.arrays(np.int16, n, elements=st.integers(-128, 127)))
    wider = data.draw(npst.arrays(np.int16, n, elements=st.integers(0, 255)))
    low = (3 * cell_bits(classes - wider, grid)).astype(np.uint64)
    morton = data.draw(npst.arrays(np.uint64, n, elements=st.integers(0, 2**63 - 1))) >> low << low
    order = np.argsort(morton, kind="stable")
    depths = data.draw(npst.arrays(np.uint8, n))
    coarser = [0, *sorted(data.draw(st.lists(st.integers(0, 21), max_size=3)))]
    keyframe = sidecar.KeyframeSidecar(morton[order], classes[order], wider[order], depths)
    packed = sidecar.pack_keyframe_sidecar(keyframe, grid, coarser[-1])
    assert sidecar.detail_columns(keyframe, grid, coarser[-1], coarser[-1]) == []
    shared = sidecar.unpack_keyframe_sidecar(packed, n, grid, coarser[-1], "x")
    for name in ("classes", "depths", "wider"):
        np.testing.assert_array_equal(getattr(shared, name), getattr(keyframe, name))
    for r in coarser:
        reader = ColumnReader(encode_columns(sidecar.detail_columns(keyframe, grid, r, coarser[-1])), "x")
        own = sidecar.read_detail(reader, shared, grid, r, coarser[-1])
        reader.close()
        np.testing.assert_array_equal(own.codes, coarse_codes(keyframe.codes, keyframe.cells, grid, r))
    nothing = ColumnReader(b"\0" * 5, "x")
    np.testing.assert_array_equal(sidecar.read_detail(nothing, shared, grid, r, r).codes, shared.codes)
    alone = sidecar.KeyframeSidecar(np.empty(0, np.uint64), np.empty(0, np.int16), np.empty(0, np.int16), depths)
    read = sidecar.unpack_keyframe_sidecar(sidecar.pack_keyframe_sidecar(alone, grid), n, grid, 0, "x", True)
    np.testing.assert_array_equal(read.depths, depths)
    assert not len(read.codes) and not len(read.classes)
