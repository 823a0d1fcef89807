"""Positions of key tiers are exact in every key quality; what is refused is in the vectors (tests/vectors)."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from airgs_codec.coding.grid import cell_bits, coarse_codes
from airgs_codec.coding.rangecoder import ColumnReader, encode_columns
from airgs_codec.coding.sidecar import KeySidecar, detail_columns, pack_key_sidecar, read_detail, unpack_key_sidecar
from tests.faces import FormatError, Grid


@given(st.binary(max_size=200))
def test_any_bytes_as_a_sidecar_are_refused_with_a_reason(data):
    with pytest.raises(FormatError) as caught:
        unpack_key_sidecar(data, 7, Grid([0, 0, 0], 1.0, 0), 2, "x.bin")
    assert caught.value.reason == "bad_sidecar"


@given(st.data())
def test_key_sidecars_are_exact(data):
    n = data.draw(st.integers(1, 40))
    grid = Grid([0, 0, 0], 1.0, data.draw(st.integers(-128, 127)))
    classes = data.draw(npst.arrays(np.int16, n, elements=st.integers(-128, 127)))
    wider = data.draw(npst.arrays(np.int16, n, elements=st.integers(0, 255)))
    low = (3 * cell_bits(classes - wider, grid)).astype(np.uint64)
    morton = data.draw(npst.arrays(np.uint64, n, elements=st.integers(0, 2**63 - 1))) >> low << low
    order = np.argsort(morton, kind="stable")
    morton, classes, wider = morton[order], classes[order], wider[order]
    depths = data.draw(npst.arrays(np.uint8, n))
    coarser = [0, *sorted(data.draw(st.lists(st.integers(0, 21), max_size=3)))]
    sidecar = KeySidecar(morton, classes, wider, depths)
    packed = pack_key_sidecar(sidecar, grid, coarser[-1])
    assert detail_columns(sidecar, grid, coarser[-1], coarser[-1]) == []
    shared = unpack_key_sidecar(packed, n, grid, coarser[-1], "x")
    np.testing.assert_array_equal(shared.classes, classes)
    np.testing.assert_array_equal(shared.depths, depths)
    np.testing.assert_array_equal(shared.wider, wider)
    for r in coarser:
        reader = ColumnReader(encode_columns(detail_columns(sidecar, grid, r, coarser[-1])), "x")
        own = read_detail(reader, shared, grid, r, coarser[-1])
        reader.close()
        np.testing.assert_array_equal(own.codes, coarse_codes(morton, sidecar.cells, grid, r))
    np.testing.assert_array_equal(read_detail(ColumnReader(b"\0" * 5, "x"), shared, grid, r, r).codes, shared.codes)


GRID = Grid([0, 0, 0], 1.0, 0)


NONE = np.empty(0, np.int16)


@given(npst.arrays(np.uint8, st.integers(1, 40)))
def test_depths_alone_are_exact(depths):
    packed = pack_key_sidecar(KeySidecar(np.empty(0, np.uint64), NONE, NONE, depths), GRID)
    read = unpack_key_sidecar(packed, len(depths), GRID, 0, "x", True)
    np.testing.assert_array_equal(read.depths, depths)
    assert not len(read.codes) and not len(read.classes)
