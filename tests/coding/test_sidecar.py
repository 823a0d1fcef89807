"""Sidecars of key units are exact, and any other bytes are refused with a reason."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from airgs_codec.coding.grid import cell_bits
from airgs_codec.coding.sidecar import KeySidecar, pack_key_sidecar, unpack_key_sidecar
from airgs_codec.errors import FormatError
from airgs_codec.package.tables import Grid


@given(st.binary(max_size=200))
@settings(deadline=None)  # the first call compiles
def test_any_bytes_as_a_sidecar_are_refused_with_a_reason(data):
    with pytest.raises(FormatError) as caught:
        unpack_key_sidecar(data, 7, Grid([0.0, 0.0, 0.0], 1.0, 21, 0), "x.bin")
    assert caught.value.reason == "bad_sidecar"


def test_codes_that_leave_the_grid_are_refused():
    """63 is the last of 4 x 4 x 4 cells; the same gaps lead out of a smaller grid."""
    large, small = Grid([0.0, 0.0, 0.0], 1.0, 2, 0), Grid([0.0, 0.0, 0.0], 1.0, 1, 0)
    good = KeySidecar(np.array([8, 63], np.uint64), np.array([1, 0], np.int16), np.zeros(2, np.uint8))
    packed = pack_key_sidecar(good, large)
    np.testing.assert_array_equal(unpack_key_sidecar(packed, 2, large, "x").codes, good.codes)
    with pytest.raises(FormatError) as caught:
        unpack_key_sidecar(packed, 2, small, "x")
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
    packed = pack_key_sidecar(KeySidecar(morton, classes, depths), grid)
    back = unpack_key_sidecar(packed, n, grid, "x")
    np.testing.assert_array_equal(back.codes, morton)
    np.testing.assert_array_equal(back.classes, classes)
    np.testing.assert_array_equal(back.depths, depths)
