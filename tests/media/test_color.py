"""CIEDE2000 of pictures: published pairs, and pictures larger than what is compared of them."""

import subprocess
import sys

import numpy as np
import pytest

from airgs_codec.media.color import MAX_PIXELS, delta_e


def plain(colour, height=8, width=8):
    return np.full((height, width, 3), colour, np.float32)


@pytest.mark.parametrize(
    ("a", "b", "expected"),
    [
        ((0.2, 0.4, 0.6), (0.2, 0.4, 0.6), 0.0),
        ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 100.0),  # black and white: L* of 0 and 100
        ((0.0, 0.0, 0.0), (9.0, 9.0, 9.0), 100.0),  # shown as white
        ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), 86.615),  # sRGB's red and green, by Sharma's formula
        ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), 52.881),
    ],
)
def test_plain_colours(a, b, expected):
    assert delta_e(plain(a), plain(b)) == pytest.approx(expected, abs=0.02)


def test_a_part_of_the_pixels_stands_for_a_large_picture():
    rng = np.random.default_rng(1)
    a = rng.random((200, 300, 3)).astype(np.float32)
    b = (a + rng.normal(size=a.shape) * 0.05).astype(np.float32)
    strips = [delta_e(a[:, i : i + 40], b[:, i : i + 40]) for i in range(0, 280, 40)]  # small enough: all their pixels
    assert 200 * 40 < MAX_PIXELS < 200 * 300
    assert delta_e(a, b) == pytest.approx(np.mean(strips), rel=0.02)


def test_numbers_print_as_before():
    """Importing colour-science sets numpy's print options for the whole process."""
    code = (
        "import numpy as np; from airgs_codec.media.color import delta_e;"
        "before = np.get_printoptions(), str(np.float32(1000001));"
        "delta_e(np.zeros((8, 8, 3), 'f4'), np.ones((8, 8, 3), 'f4'));"
        "assert (np.get_printoptions(), str(np.float32(1000001))) == before"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
