"""Orders, transforms, quantisation, escapes and sidecars: every round trip with its bound."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from airgs_codec.coding import escapes
from airgs_codec.coding.attributes import OPACITY_MARGIN, from_opacity, to_opacity
from airgs_codec.coding.colour import fit_colour_transform, from_klt, to_klt
from airgs_codec.coding.grid import cell_bits, fit_grid, grid_codes, grid_means
from airgs_codec.coding.morton import morton_decode, morton_encode
from airgs_codec.coding.quantize import from_codes, to_codes
from airgs_codec.coding.rangecoder import MOST, Reader, encode_columns
from airgs_codec.coding.sidecar import KeySidecar, pack_key_sidecar, unpack_key_sidecar
from airgs_codec.encoder.levels import assign_depths, assign_tiers
from airgs_codec.errors import FormatError, SceneError
from airgs_codec.package.tables import STATIC, Grid, pack_matrix, unpack_matrix
from airgs_codec.scene.rotations import conjugate, from_rotation_vector, multiply, to_rotation_vector

finite = st.floats(-1e6, 1e6, width=32)


@given(npst.arrays(np.int64, st.tuples(st.integers(1, 50), st.just(3)), elements=st.integers(0, 2**21 - 1)))
def test_morton_codes_invert(index):
    np.testing.assert_array_equal(morton_decode(morton_encode(index)), index)


def test_morton_bits_interleave_x_first():
    assert morton_encode(np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [2, 0, 0], [3, 3, 3]])).tolist() == [1, 2, 4, 8, 63]


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


unit = npst.arrays(np.float64, (20, 4), elements=st.floats(-1, 1)).filter(
    lambda q: np.linalg.norm(q, axis=1).min() > 1e-3
)


@given(unit, unit)
def test_rotation_vectors_invert_up_to_sign(a, b):
    a = a / np.linalg.norm(a, axis=1, keepdims=True)
    b = b / np.linalg.norm(b, axis=1, keepdims=True)
    relative = to_rotation_vector(multiply(a, conjugate(b)))
    back = multiply(from_rotation_vector(relative), b)
    np.testing.assert_allclose(np.abs((back * a).sum(axis=1)), 1, atol=1e-7)
    assert np.linalg.norm(relative, axis=1).max() <= np.pi + 1e-9


def test_rotation_vectors_at_the_extremes():
    q = np.array([[1, 0, 0, 0], [-1, 0, 0, 0], [0, 1, 0, 0], [1, 1e-12, 0, 0]])
    v = to_rotation_vector(q)
    np.testing.assert_allclose(v, [[0, 0, 0], [0, 0, 0], [np.pi, 0, 0], [2e-12, 0, 0]], atol=1e-15)


@given(npst.arrays(np.float32, 20, elements=st.floats(-0.5, 1.5, width=32)))
def test_decoded_opacity_always_has_a_finite_logit_and_is_exact_inside(alpha):
    logits = from_opacity(alpha)
    assert np.isfinite(logits).all()
    inside = np.clip(alpha, OPACITY_MARGIN, 1 - OPACITY_MARGIN)
    np.testing.assert_allclose(to_opacity(logits), inside, atol=2e-7)


def test_logit_extremes_have_finite_opacity():
    assert to_opacity(np.array([-np.inf, -100.0, 0.0, 100.0, np.inf])).tolist()[::2] == [0.0, 0.5, 1.0]


@pytest.mark.parametrize("channels", [3, 12, 27, 48])
def test_the_stored_colour_transform_inverts_exactly(channels):
    colour = np.random.default_rng(0).normal(size=(500, channels)) @ np.random.default_rng(1).normal(
        size=(channels,) * 2
    )
    stored = unpack_matrix(pack_matrix(fit_colour_transform(colour)), channels)
    np.testing.assert_allclose(stored @ stored.T, np.eye(channels), atol=1e-3)
    back = from_klt(to_klt(colour, stored), stored)
    np.testing.assert_allclose(back, colour, atol=1e-9 * np.abs(colour).max())


def test_the_colour_transform_of_constant_colours_is_orthonormal():
    t = fit_colour_transform(np.ones((5, 12)))
    np.testing.assert_allclose(t @ t.T, np.eye(12), atol=1e-12)


@given(
    values=npst.arrays(np.float64, (3, 2, 5), elements=st.floats(-1e3, 1e3)),
    step=st.floats(1e-3, 10),
    gain=st.floats(1, 16),
)
def test_quantisation_error_is_at_most_half_a_code(values, step, gain):
    steps = np.array([step, 2 * step])
    for t in range(3):
        back = from_codes(to_codes(values, steps, gain)[t], steps, gain)
        error = np.abs(back - values[t])
        bound = steps[:, None] / (2 * gain) + 1e-6 * np.abs(values[t]) + 1e-9
        assert (error <= bound).all()


@pytest.mark.parametrize("value", [1e30, np.inf, np.nan])
def test_what_no_code_holds_is_refused_and_never_clipped(value):
    with np.errstate(all="ignore"), pytest.raises(SceneError, match="channel 1"):
        to_codes(np.array([[[0.0], [value]]]), np.array([1.0, 1.0]), 3.0)


codes = npst.arrays(
    np.int32,
    st.tuples(st.integers(1, 6), st.integers(1, 3), st.integers(1, 8)),
    elements=st.one_of(st.integers(-100, 100), st.integers(-(2**30) + 1, 2**30 - 1)),
)


@given(codes)
@settings(max_examples=200, deadline=None)  # the first call compiles
def test_escapes_are_lossless_and_stay_off_the_ends_of_luma(values):
    luma, bases = escapes.split(values)
    assert luma.min() >= 20 and luma.max() <= 236
    np.testing.assert_array_equal(luma.astype(np.int64) - 128 + escapes.UNIT * bases.astype(np.int64), values)
    reader = Reader(encode_columns(escapes.columns(bases)), "here")
    index, jumps = escapes.read(reader, values.shape, "here")
    reader.close()
    for t in range(len(values)):
        np.testing.assert_array_equal(escapes.bases_at(index, jumps, values.shape, t), bases[t])


def fewest_jumps(series):
    """Of one sample, by trying every base in every frame."""
    cost = {0: 0}
    for code in series:
        serving = [b for b in range(-4, 5) if abs(code - escapes.UNIT * b) <= escapes.LIMIT]
        cost = {b: min(c + (b != a) for a, c in cost.items()) for b in serving}
    return min(cost.values())


@given(st.lists(st.integers(-400, 400), min_size=1, max_size=9))
def test_no_choice_of_bases_jumps_less(series):
    _, bases = escapes.split(np.array(series, np.int32)[:, None, None])
    assert np.count_nonzero(np.diff(bases[:, 0, 0], prepend=0)) == fewest_jumps(series)


@given(st.binary(max_size=200))
@settings(deadline=None)  # the first call compiles
def test_any_bytes_as_a_sidecar_are_refused_with_a_reason(data):
    with pytest.raises(FormatError) as caught:
        unpack_key_sidecar(data, 7, Grid([0.0, 0.0, 0.0], 1.0, 21, 0), "x.bin")
    assert caught.value.reason == "bad_sidecar"


columns = st.lists(
    st.tuples(
        npst.arrays(np.int64, st.integers(0, 60), elements=st.one_of(st.integers(0, 9), st.integers(0, MOST))),
        st.sampled_from([0, 1]),
    ),
    max_size=4,
)


@given(columns)
@settings(deadline=None)  # the first call compiles
def test_coded_columns_are_exact(written):
    reader = Reader(encode_columns(written), "x")
    for values, order in written:
        np.testing.assert_array_equal(reader.column(len(values), order), values)
    reader.close()


def test_columns_longer_than_a_batch_are_exact_and_near_their_entropy():
    rng = np.random.default_rng(3)
    values = rng.geometric(0.3, 100_000)
    coded = encode_columns([(values, 0)])
    np.testing.assert_array_equal(Reader(coded, "x").column(len(values), 0), values)
    share = 0.3 * 0.7 ** (np.arange(1, 60) - 1)
    entropy = -(share * np.log2(share)).sum()
    assert 8 * len(coded) / len(values) < 1.03 * entropy


def test_the_number_before_helps_order_1():
    walk = np.random.default_rng(3).integers(0, 2, 5000).cumsum() // 100 % 9
    assert len(encode_columns([(walk, 1)])) < 0.5 * len(encode_columns([(walk, 0)]))


@pytest.mark.parametrize("change", [lambda b: b[:-1], lambda b: b + b"\0", lambda b: b"\1" + b[1:], lambda b: b[:4]])
def test_a_column_file_cut_or_extended_is_refused(change):
    values = np.arange(50)
    with pytest.raises(FormatError) as caught:
        reader = Reader(change(encode_columns([(values, 0)])), "x.bin")
        reader.column(50, 0)
        reader.close()
    assert caught.value.reason == "bad_sidecar"


def test_more_escapes_than_samples_are_refused():
    bomb = encode_columns([(np.array([10**15]), 0)])
    with pytest.raises(FormatError, match="at most 70 escapes"):
        escapes.read(Reader(bomb, "x.bin"), (1, 2, 35), "x.bin")


def test_negative_numbers_are_no_columns():
    with pytest.raises(ValueError, match="-1"):
        encode_columns([(np.array([3, -1]), 0)])


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


def test_tiers_hold_the_most_used_first():
    usage = np.array([0.1, 0.9, 0.5, 0.7, 0.3])
    assert assign_tiers(usage, (0.4, 0.6)).tolist() == [1, 0, 1, 0, 1]
    assert assign_tiers(np.ones(1), (0.8, 0.2)).tolist() == [0]
    assert assign_tiers(np.array([1.0, 2.0]), (0.1, 0.9)).tolist() == [1, 0]  # the first is never empty


@given(
    npst.arrays(np.float64, 30, elements=st.floats(0, 10)),
    npst.arrays(np.bool_, 30),
    st.lists(st.floats(0, 0.99), min_size=1, max_size=6).map(sorted),
)
def test_levels_are_nested_and_withhold_their_share_of_the_lowest_scores(score, moving, shares):
    depths = assign_depths(score, moving, shares)
    assert (depths[~moving] == STATIC).all()
    for level, share in enumerate(shares):
        kept = (depths >= level) & (depths != STATIC)
        assert kept.sum() == round((1 - share) * moving.sum())
        if kept.any() and (moving & ~kept).any():
            assert score[kept].min() >= score[moving & ~kept].max()
