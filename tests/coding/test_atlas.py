"""Atlases: every sample finds its cell and comes back from it."""

from dataclasses import replace

import hypothesis.extra.numpy as npst
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from airgs_codec.coding.atlas import assemble, choose_layout, extract, fit_atlas, picture_size, row_places
from airgs_codec.package.tables import MAX_PAGES
from tests.faces import Atlas


@pytest.mark.parametrize("rows", [1, 2, 255, 256, 257, 511, 4096, 5000])
@pytest.mark.parametrize("planes", [1, 3, 19])
def test_samples_come_back_from_their_cells(rows, planes):
    width, columns = choose_layout(rows, planes)
    layout = Atlas(rows, [0] * planes, list(range(planes)), width, columns)
    size = picture_size(layout)
    assert size[0] >= 64 and size[1] >= 64 and size[0] % 16 == 0 and size[1] % 16 == 0
    samples = np.random.default_rng(0).integers(0, 256, (2, planes, rows)).astype(np.uint8)
    pictures = assemble(samples, layout, *size)
    for picture, expected in zip(pictures, samples, strict=True):
        np.testing.assert_array_equal(extract(picture, layout), expected)
    larger = assemble(samples, layout, size[0] + 32, size[1] + 64)
    np.testing.assert_array_equal(extract(larger[1], layout), samples[1])


def test_a_picture_that_is_too_small_is_not_read():
    layout = Atlas(300, [0], [0], 32, 1)
    for shape in [(8, 64), (64, 16)]:
        with pytest.raises(ValueError, match="expected a picture of at least"):
            extract(np.zeros(shape, np.uint8), layout)


def test_a_block_is_filled_along_a_z_curve():
    layout = Atlas(300, [0], [0], 32, 1)
    index = row_places(300, 32, 64)
    assert [divmod(int(i), 64) for i in index[:5]] == [(0, 0), (0, 1), (1, 0), (1, 1), (0, 2)]
    assert divmod(int(index[256]), 64) == (0, 16)  # the next block is to the right
    assert picture_size(layout) == (64, 64)


@settings(max_examples=100)
@given(
    codes=npst.arrays(np.int32, (1, 1, 8), elements=st.integers(-9, 9)),
    limit=st.sampled_from([0.5, 1.5, 2 ** (10 / 6) / 2, 2 ** (16 / 6) / 2]),
)
def test_a_channel_without_a_plane_is_within_the_limit_of_its_centre(codes, limit):
    atlas = fit_atlas(codes, limit)
    error = np.abs(codes - atlas.centres[0]).max()
    assert atlas.planes or error <= limit


def test_three_codes_apart_need_a_plane_where_the_limit_is_one_and_a_half():
    """Whole centres leave 2 codes to one side; a key step is 3.17 codes, half of it 1.59."""
    codes = np.array([[[0, 3, 1, 2]], [[0, 2, 1, 1]]], np.int32)
    assert fit_atlas(codes[:1], 1.59).planes == [0]
    assert fit_atlas(codes[1:], 1.59).planes == []


@pytest.mark.parametrize(("rows", "planes"), [(1, 1), (500_000, 55), (1 << 24, 1), (1 << 24, 58), (9_437_185, 1)])
def test_pictures_stay_within_what_decoders_take(rows, planes):
    """36,864 macroblocks and 4096 samples a side; what is more becomes pages."""
    width, columns = choose_layout(rows, planes)
    layout = Atlas(rows, [0] * planes, list(range(planes)), width, columns)
    size = picture_size(layout)
    layout = replace(layout, width=size[0], height=size[1])
    assert max(size) <= 4096 and size[0] * size[1] <= 36_864 * 256
    assert layout.pages <= MAX_PAGES
    assert layout.pages == 1 or layout.size[0] * layout.size[1] > 36_864 * 256
    assert layout.pages * size[0] * size[1] < 1.3 * planes * rows + 64 * 64


@pytest.mark.parametrize("macroblocks", [16, 40])
def test_samples_come_back_from_pages(macroblocks):
    layout = Atlas(5000, [0] * 3, [0, 1, 2], *choose_layout(5000, 3))
    size = picture_size(layout, macroblocks)
    samples = np.random.default_rng(0).integers(0, 256, (1, 3, 5000)).astype(np.uint8)
    (picture,) = assemble(samples, layout, *size)
    pages = replace(layout, width=size[0], height=size[1]).pages
    assert pages > 1 and picture.shape == (pages * size[1], size[0])
    np.testing.assert_array_equal(extract(picture, layout), samples[0])
