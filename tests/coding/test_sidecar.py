"""Positions of key units are exact in every key quality, and any other bytes are refused with a reason."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from airgs_codec.coding.grid import cell_bits, coarse_codes
from airgs_codec.coding.rangecoder import ColumnReader, encode_columns
from airgs_codec.coding.sidecar import (
    Kept,
    KeySidecar,
    detail_columns,
    pack_key_sidecar,
    read_detail,
    unpack_key_sidecar,
)
from airgs_codec.errors import FormatError
from airgs_codec.package.tables import Grid


@given(st.binary(max_size=200))
@settings(deadline=None)  # the first call compiles
def test_any_bytes_as_a_sidecar_are_refused_with_a_reason(data):
    with pytest.raises(FormatError) as caught:
        unpack_key_sidecar(data, 7, Grid([0.0, 0.0, 0.0], 1.0, 21, 0), 2, "x.bin")
    assert caught.value.reason == "bad_sidecar"


def test_codes_that_leave_the_grid_are_refused():
    """63 is the last of 4 x 4 x 4 cells; the same gaps lead out of a smaller grid."""
    large, small = Grid([0.0, 0.0, 0.0], 1.0, 2, 0), Grid([0.0, 0.0, 0.0], 1.0, 1, 0)
    good = KeySidecar(np.array([8, 63], np.uint64), np.array([1, 0], np.int16), np.zeros(2, np.uint8))
    packed = pack_key_sidecar(good, large)
    np.testing.assert_array_equal(unpack_key_sidecar(packed, 2, large, 0, "x").codes, good.codes)
    with pytest.raises(FormatError) as caught:
        unpack_key_sidecar(packed, 2, small, 0, "x")
    assert caught.value.reason == "bad_sidecar"


@given(st.data())
@settings(deadline=None)  # the first call compiles
def test_key_sidecars_are_exact(data):
    n = data.draw(st.integers(1, 40))
    grid = Grid([0.0, 0.0, 0.0], 1.0, 21, data.draw(st.integers(-128, 127)))
    classes = data.draw(npst.arrays(np.int16, n, elements=st.integers(-128, 127)))
    low = (3 * cell_bits(classes, grid)).astype(np.uint64)
    morton = data.draw(npst.arrays(np.uint64, n, elements=st.integers(0, 2**63 - 1))) >> low << low
    order = np.argsort(morton, kind="stable")
    morton, classes = morton[order], classes[order]
    depths = data.draw(npst.arrays(np.uint8, n))
    coarser = [0, *sorted(data.draw(st.lists(st.integers(0, 21), max_size=3)))]
    sidecar = KeySidecar(morton, classes, depths)
    packed = pack_key_sidecar(sidecar, grid, coarser[-1])
    shared = unpack_key_sidecar(packed, n, grid, coarser[-1], "x")
    np.testing.assert_array_equal(shared.classes, classes)
    np.testing.assert_array_equal(shared.depths, depths)
    for r in coarser:
        reader = ColumnReader(encode_columns(detail_columns(sidecar, grid, r, coarser[-1])), "x")
        own = read_detail(reader, shared, grid, r, coarser[-1])
        reader.close()
        np.testing.assert_array_equal(own.codes, coarse_codes(morton, classes, grid, r))
    np.testing.assert_array_equal(read_detail(ColumnReader(b"\0" * 5, "x"), shared, grid, r, r).codes, shared.codes)


GRID = Grid([0.0, 0.0, 0.0], 1.0, 2, 0)
OTHERS = KeySidecar(np.array([8, 63], np.uint64), np.array([1, 0], np.int16), np.array([255, 1], np.uint8))
NO_OTHERS = KeySidecar(np.empty(0, np.uint64), np.empty(0, np.int16), np.empty(0, np.uint8))


@pytest.mark.parametrize("others", [OTHERS, NO_OTHERS], ids=["with others", "all kept"])
@pytest.mark.parametrize("rows", [[0, 1, 2, 3], [2], [0, 3]], ids=str)
def test_kept_rows_stand_in_front(others, rows):
    kept = Kept(np.array(rows), np.resize(np.array([255, 0, 3], np.uint8), len(rows)))
    packed = pack_key_sidecar(replace(others, kept=kept), GRID)
    read = unpack_key_sidecar(packed, len(others.codes), GRID, 0, "x", (len(rows), 4))
    np.testing.assert_array_equal(read.kept.rows, kept.rows)
    np.testing.assert_array_equal(read.kept.depths, kept.depths)
    for name in ("codes", "classes", "depths"):
        np.testing.assert_array_equal(getattr(read, name), getattr(others, name))


@pytest.mark.parametrize("gaps", [[4, 0], [0, 3], [2**62, 2**62]], ids=str)
def test_kept_rows_past_the_tier_of_their_group_are_refused(gaps):
    packed = encode_columns([(np.array(gaps), 1), (np.zeros(2, np.int64), 1)])
    with pytest.raises(FormatError, match="kept rows below 4") as caught:
        unpack_key_sidecar(packed, 0, GRID, 0, "x", (2, 4))
    assert caught.value.reason == "bad_sidecar"


def test_a_depth_of_a_kept_row_past_255_is_refused():
    packed = encode_columns([(np.array([1]), 1), (np.array([256]), 1)])
    with pytest.raises(FormatError, match="depths up to 255"):
        unpack_key_sidecar(packed, 0, GRID, 0, "x", (1, 4))


def test_qualities_with_equal_cells_share_the_whole_of_a_position():
    grid = Grid([0.0, 0.0, 0.0], 1.0, 4, 0)
    sidecar = KeySidecar(np.array([8, 63], np.uint64), np.array([1, 0], np.int16), np.zeros(2, np.uint8))
    assert detail_columns(sidecar, grid, 0, 0) == detail_columns(sidecar, grid, 2, 2) == []
    packed = pack_key_sidecar(sidecar, grid)
    np.testing.assert_array_equal(unpack_key_sidecar(packed, 2, grid, 0, "x").codes, sidecar.codes)


@pytest.mark.parametrize("detail", [[64, 0], [0, 8], [7, 2**62], [7]], ids=str)
def test_a_detail_that_leaves_its_cell_or_is_short_is_refused(detail):
    """Cells of 1 and 8 steps in a grid of 16 steps: those of quality 2, of 4 and 16, hold 64 and 8 of them."""
    grid = Grid([0.0, 0.0, 0.0], 1.0, 4, 0)
    shared = KeySidecar(np.zeros(2, np.uint64), np.array([0, 3], np.int16), np.zeros(2, np.uint8))
    good = ColumnReader(encode_columns([(np.array([63, 7]), 0)]), "x")
    np.testing.assert_array_equal(read_detail(good, shared, grid, 0, 2).codes, [63, 7 << 9])
    with pytest.raises(FormatError) as caught:
        reader = ColumnReader(encode_columns([(np.array(detail), 0)]), "x")
        read_detail(reader, shared, grid, 0, 2)
        reader.close()
    assert caught.value.reason == "bad_sidecar"
