"""Quality of pictures against plain float64 definitions and published pairs of colours."""

import subprocess
import sys

import numpy as np
import pytest

from airgs_codec.media.metrics import MOST_COLOURS, delta_e_metric
from tests.faces import PSNR_CAP, Difference, Picture, Quality, mse, pool, psnr
from tests.support.plain_metrics import plain_mse, plain_ssim


@pytest.fixture(params=[0.002, 0.05, 0.5])
def pictures(request):
    """A picture and a noisy one; both leave [0, 1], and the first is black in one corner."""
    rng = np.random.default_rng(0)
    ramp = np.linspace(-0.1, 1.1, 24 * 31 * 3).reshape(24, 31, 3)
    ramp[:12, :12] = 0
    return ramp.astype(np.float32), (ramp + rng.normal(0, request.param, ramp.shape)).astype(np.float32)


def test_similarity_is_that_of_the_definition(pictures):
    a, b = map(Picture.of, pictures)
    assert a.ssim(b) == pytest.approx(plain_ssim(*pictures), abs=1e-5)
    assert b.ssim(a) == pytest.approx(a.ssim(b), abs=1e-6)


def test_nothing_of_one_comparison_is_left_for_the_next(pictures):
    before = [picture.copy() for picture in pictures]
    a, b = map(Picture.of, pictures)
    for _ in range(2):
        for first, second in ((a, b), (b, a), (a, a)):
            alone = Difference.of(Picture.of(first.rgb), Picture.of(second.rgb))
            assert Difference.of(first, second) == alone
    for picture, same in zip(pictures, before, strict=True):
        np.testing.assert_array_equal(picture, same)


def test_the_squared_error_is_of_what_a_screen_shows(pictures):
    a, b = pictures
    assert mse(a, b) == pytest.approx(plain_mse(a, b), rel=1e-6)
    assert mse(np.full_like(a, 7), np.full_like(a, 1)) == 0


def test_equal_pictures_have_the_largest_psnr(pictures):
    a, _ = pictures
    assert psnr(mse(a, a)) == PSNR_CAP == psnr(1e-30)
    assert psnr(1e-4) == pytest.approx(40)


def test_many_pictures_have_the_mean_error_and_the_worst_one():
    differences = [
        Difference(error, ssim, colour) for error, ssim, colour in ((1e-4, 0.9, 1), (1e-2, 0.5, 4), (4e-4, 1, 1))
    ]
    assert pool(differences) == Quality(psnr(0.0105 / 3), pytest.approx(20), pytest.approx(0.8), pytest.approx(2))
    assert pool([Difference(0.0, 1.0, 0.0)]) == Quality(PSNR_CAP, PSNR_CAP, 1, 0)


def plain(colour, height=8, width=8):
    return Picture.of(np.full((height, width, 3), colour, np.float32))


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
    assert plain(a).delta_e(plain(b)) == pytest.approx(expected, abs=0.02)


def test_a_part_of_the_pixels_stands_for_large_pictures():
    rng = np.random.default_rng(1)
    parts = [slice(i, i + 10) for i in range(0, 300, 10)]  # small enough: all their pixels
    assert 200 * 10 < MOST_COLOURS < 200 * 300
    wholes, strips = [], []
    for _ in range(4):
        a = rng.random((200, 300, 3)).astype(np.float32)
        b = (a + rng.normal(size=a.shape) * 0.05).astype(np.float32)
        wholes.append(Picture.of(a).delta_e(Picture.of(b)))
        assert wholes[-1] == Picture.of(a[::6, ::6]).delta_e(Picture.of(b[::6, ::6]))
        strips += [Picture.of(a[:, part]).delta_e(Picture.of(b[:, part])) for part in parts]
    assert np.mean(wholes) == pytest.approx(np.mean(strips), rel=0.02)


def test_numbers_print_as_before():
    """Importing colour-science sets numpy's print options for the whole process."""
    code = (
        "import numpy as np; from airgs_codec.media.metrics import Picture;"
        "before = np.get_printoptions(), str(np.float32(1000001));"
        "Picture.of(np.zeros((8, 8, 3), 'f4')).delta_e(Picture.of(np.ones((8, 8, 3), 'f4')));"
        "assert (np.get_printoptions(), str(np.float32(1000001))) == before"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_the_metric_of_colours_says_how_delta_e_grows():
    """A small change of all samples makes about the CIEDE2000 that the metric says, along any direction."""
    rng = np.random.default_rng(3)
    picture = Picture.of(rng.uniform(0.2, 0.8, (40, 40, 3)).astype(np.float32))
    rgb = picture.sampled.reshape(-1, 3)
    metric = delta_e_metric(np.concatenate([rgb, np.zeros((99, 3))]))  # black counts for nothing
    for change in ((0.01, 0, 0), (0, 0.01, 0), (0.004, -0.004, 0.002), (0.003, 0.003, 0.003)):
        other = Picture.of(picture.rgb + np.float32(change))
        assert picture.delta_e(other) == pytest.approx(np.sqrt(change @ metric @ change), rel=0.2)
    np.testing.assert_array_equal(delta_e_metric(np.zeros((8, 3))), np.eye(3))
