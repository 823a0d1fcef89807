"""Values become codes, escapes and samples of planes, and come back; rows are worked on a few at a time."""

import itertools
import os
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from airgs_codec.coding import atlas, channels, escapes, kernels
from tests import faces
from tests.faces import Atlas, from_codes, pack_matrix, sigmoid, to_codes, unpack_matrix


@given(npst.arrays(np.float64, (3, 2, 5), elements=st.floats(-1e3, 1e3)), st.floats(1e-3, 10), st.floats(1, 16))
def test_quantisation_error_is_at_most_half_a_code(values, step, gain):
    steps = np.array([step, 2 * step])
    for t in range(3):
        error = np.abs(from_codes(to_codes(values, steps, gain)[t], steps, gain) - values[t])
        bound = steps[:, None] / (2 * gain) + 1e-6 * np.abs(values[t]) + 1e-9
        assert (error <= bound).all()


def test_what_no_code_holds_and_a_step_that_float32_cannot_hold_are_refused_and_never_clipped():
    for value in (1e30, np.inf, np.nan):
        with np.errstate(all="ignore"), pytest.raises(faces.SceneError, match="channel 1"):
            to_codes(np.array([[[0.0], [value]]]), np.array([1.0, 1.0]), 3.0)
    zeros = np.zeros((1, 2, 3))
    for step in (1e-40, 1e40, 0.0, np.inf, np.nan):
        with pytest.raises(faces.SceneError, match=r"channel 1: expected a step of 1e-30 to 1e\+30, got"):
            to_codes(zeros, np.array([1.0, step]), 1.0)
    for held in (1e-30, 1e30):
        steps = np.array([1.0, held])
        assert (from_codes(to_codes(zeros, steps, 1.0)[0], steps, 1.0) == 0).all()


@pytest.mark.parametrize("count", [3, 12, 27, 48])
def test_the_stored_colour_transform_inverts_exactly_and_that_of_constant_colours_is_orthonormal(count):
    first, second = (np.random.default_rng(seed) for seed in (0, 1))
    colour = first.normal(size=(500, count)) @ second.normal(size=(count, count))
    stored = unpack_matrix(pack_matrix(channels.fit_colour_transform(colour)), count)
    np.testing.assert_allclose(stored @ stored.T, np.eye(count), atol=1e-3)
    back = channels.to_klt(colour, stored) @ stored
    np.testing.assert_allclose(back, colour, atol=1e-9 * np.abs(colour).max())
    constant = channels.fit_colour_transform(np.ones((5, count)))
    np.testing.assert_allclose(constant @ constant.T, np.eye(count), atol=1e-12)


@given(npst.arrays(np.float32, 20, elements=st.floats(-0.5, 1.5, width=32)))
def test_decoded_opacity_always_has_a_finite_logit_and_is_exact_inside(alpha):
    logits = channels.from_opacity(alpha)
    assert np.isfinite(logits).all()
    inside = np.clip(alpha, 2.0**-20, 1 - 2.0**-20)
    np.testing.assert_allclose(sigmoid(logits), inside, atol=2e-7)
    assert sigmoid(np.array([-np.inf, -100.0, 0.0, 100.0, np.inf])).tolist()[::2] == [0.0, 0.5, 1.0]


shapes = st.tuples(st.integers(1, 6), st.integers(1, 3), st.integers(1, 8))
numbers = st.one_of(st.integers(-100, 100), st.integers(-(2**30) + 1, 2**30 - 1))


@given(npst.arrays(np.int32, shapes, elements=numbers))
@settings(max_examples=200)  # the first call compiles
def test_escapes_are_lossless_and_stay_off_the_ends_of_luma_also_where_planes_are_split_one_by_one(values):
    luma, bases = escapes.split(values)
    assert luma.min() >= 32 and luma.max() <= 224
    np.testing.assert_array_equal(luma.astype(np.int64) - 128 + 128 * bases.astype(np.int64), values)
    whole = escapes.Escapes.of(bases)
    unpacked = escapes.unpack_segment(escapes.pack(whole) or None, values.shape, False, "here")[1]
    for t in range(len(values)):
        np.testing.assert_array_equal(unpacked.bases(t), bases[t])
    for running, expected in zip(unpacked.running(), bases, strict=True):
        shown = [np.zeros_like(line) if base is None else base for base, line in zip(running, expected, strict=True)]
        np.testing.assert_array_equal(shown, expected)
    planes = [escapes.Escapes.of(escapes.split(values[:, p : p + 1])[1]) for p in range(values.shape[1])]
    joined = escapes.Escapes.join(planes)
    assert joined.shape == whole.shape
    assert joined.index.tolist() == whole.index.tolist() and joined.jumps.tolist() == whole.jumps.tolist()


@given(st.lists(st.integers(-400, 400), min_size=1, max_size=9))
def test_no_choice_of_bases_jumps_less_often_and_none_jumps_further_than_it_must(series):
    cost = {0: 0}  # base -> fewest jumps that lead to it, by trying every base in every frame
    for code in series:
        serving = [b for b in range(-4, 5) if abs(code - 128 * b) <= 96]
        cost = {b: min(c + (b != a) for a, c in cost.items()) for b in serving}
    _, bases = escapes.split(np.array(series, np.int32)[:, None, None])
    assert np.count_nonzero(np.diff(bases[:, 0, 0], prepend=0)) == min(cost.values())
    _, bases = escapes.split(np.array([[0, 0], [300, -300]], np.int32)[:, None])
    np.testing.assert_array_equal(bases[1, 0], [2, -2])  # 3 and -3 would serve as well


def layout_of(rows, planes):
    return Atlas(rows, [0] * planes, list(range(planes)), *atlas.choose_layout(rows, planes))


@pytest.mark.parametrize("rows", [1, 2, 255, 256, 257, 511, 4096, 5000])
@pytest.mark.parametrize("planes", [1, 3, 19])
def test_samples_come_back_from_their_cells_and_from_pages(rows, planes):
    layout = layout_of(rows, planes)
    samples = np.random.default_rng(0).integers(0, 256, (2, planes, rows)).astype(np.uint8)
    size = atlas.picture_size(layout)
    assert size[0] >= 64 and size[1] >= 64 and size[0] % 16 == 0 and size[1] % 16 == 0
    sizes = [size, (size[0] + 32, size[1] + 64)]
    if (rows, planes) == (5000, 3):
        sizes += [atlas.picture_size(layout, macroblocks) for macroblocks in (16, 40)]
    for number, (width, height) in enumerate(sizes):
        pages = replace(layout, width=width, height=height).pages
        assert (pages > 1) == (number > 1)
        for picture, expected in zip(atlas.assemble(samples, layout, width, height), samples, strict=True):
            assert picture.shape == (pages * height, width)
            np.testing.assert_array_equal(atlas.extract(picture, layout), expected)


def test_a_picture_is_64_samples_or_more_and_what_is_too_small_is_not_read():
    assert atlas.picture_size(Atlas(300, [0], [0], 32, 1)) == (64, 64)
    for shape in [(8, 64), (64, 16)]:
        with pytest.raises(ValueError, match="expected a picture of at least"):
            atlas.extract(np.zeros(shape, np.uint8), Atlas(300, [0], [0], 32, 1))


@settings(max_examples=100)
@given(
    codes=npst.arrays(np.int32, (1, 1, 8), elements=st.integers(-9, 9)),
    limit=st.sampled_from([0.5, 1.5, 2 ** (10 / 6) / 2, 2 ** (16 / 6) / 2]),
)
def test_a_channel_without_a_plane_is_within_the_limit_of_its_centre(codes, limit):
    fitted = atlas.fit_atlas(codes, limit)
    assert fitted.planes or np.abs(codes - fitted.centres[0]).max() <= limit


def test_three_codes_apart_need_a_plane_where_the_limit_is_one_and_a_half():
    """Whole centres leave 2 codes to one side; a keyframe step is 3.17 codes, half of it 1.59."""
    found = [atlas.fit_atlas(np.array([[codes]], np.int32), 1.59).planes for codes in ([0, 3, 1, 2], [0, 2, 1, 1])]
    assert found == [[0], []]


@pytest.mark.parametrize(("rows", "planes"), [(1, 1), (500_000, 55), (1 << 24, 1), (1 << 24, 58), (9_437_185, 1)])
def test_pictures_stay_within_what_decoders_take(rows, planes):
    """36,864 macroblocks and 4096 samples a side; what is more becomes pages."""
    layout = layout_of(rows, planes)
    size = atlas.picture_size(layout)
    layout = replace(layout, width=size[0], height=size[1])
    assert max(size) <= 4096 and size[0] * size[1] <= 36_864 * 256 and layout.pages <= 128
    assert layout.pages == 1 or layout.size[0] * layout.size[1] > 36_864 * 256
    assert layout.pages * size[0] * size[1] < 1.3 * planes * rows + 64 * 64


@pytest.mark.parametrize(("rows", "width"), [(0, 3), (1, 3), (2560, 1 << 20), ((3 << 20) + 1, 1)])
def test_chunks_cover_all_rows_once(rows, width):
    parts = list(kernels.row_chunks(rows, width))
    assert sum(part.stop - part.start for part in parts) == rows
    assert all(a.stop == b.start for a, b in itertools.pairwise(parts))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
def test_a_forked_process_has_threads_of_its_own():
    seen = np.zeros(2560, int)

    def work(part):
        seen[part] += 1

    kernels.for_chunks(work, len(seen), 1 << 20)
    child = os.fork()
    if child == 0:
        kernels.for_chunks(work, len(seen), 1 << 20)
        os._exit(0 if (seen == 2).all() else 1)
    assert os.waitpid(child, 0)[1] == 0 and (seen == 1).all()
