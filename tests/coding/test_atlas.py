"""Atlases: every sample finds its cell and comes back from it."""

import numpy as np
import pytest

from airgs_codec.coding.atlas import assemble, choose_layout, extract, picture_size, sample_index
from airgs_codec.package.tables import Atlas


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


def test_a_block_is_filled_along_a_z_curve():
    layout = Atlas(300, [0], [0], 32, 1)
    index = sample_index(300, 32, 1, 1, 64)[0]
    assert [divmod(int(i), 64) for i in index[:5]] == [(0, 0), (0, 1), (1, 0), (1, 1), (0, 2)]
    assert divmod(int(index[256]), 64) == (0, 16)  # the next block is to the right
    assert picture_size(layout) == (64, 64)
