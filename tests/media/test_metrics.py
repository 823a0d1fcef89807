"""Quality of pictures against their plain float64 definitions."""

import numpy as np
import pytest

from airgs_codec.media.metrics import PSNR_CAP, Reference, mse, psnr, ssim


def plain_ssim(a, b):
    """Wang et al. 2004, eq. 13, window by window."""
    x = np.arange(-5, 6)
    weights = np.exp(-(x[:, None] ** 2 + x**2) / (2 * 1.5**2))
    weights /= weights.sum()

    def local_mean(p):
        padded = np.pad(p, ((5, 5), (5, 5), (0, 0)), mode="reflect")
        return np.einsum("hwcij,ij->hwc", np.lib.stride_tricks.sliding_window_view(padded, (11, 11), (0, 1)), weights)

    a, b = np.clip(a, 0, 1).astype(np.float64), np.clip(b, 0, 1).astype(np.float64)
    ma, mb = local_mean(a), local_mean(b)
    va, vb, covariance = local_mean(a * a) - ma**2, local_mean(b * b) - mb**2, local_mean(a * b) - ma * mb
    top = (2 * ma * mb + 0.01**2) * (2 * covariance + 0.03**2)
    return float((top / ((ma**2 + mb**2 + 0.01**2) * (va + vb + 0.03**2))).mean())


@pytest.fixture(params=[0.002, 0.05, 0.5])
def pictures(request):
    """A picture and a noisy one; both leave [0, 1], and the first is black in one corner."""
    rng = np.random.default_rng(0)
    ramp = np.linspace(-0.1, 1.1, 24 * 31 * 3).reshape(24, 31, 3)
    ramp[:12, :12] = 0
    return ramp.astype(np.float32), (ramp + rng.normal(0, request.param, ramp.shape)).astype(np.float32)


def test_similarity_is_that_of_the_definition(pictures):
    a, b = pictures
    assert ssim(a, b) == pytest.approx(plain_ssim(a, b), abs=1e-5)
    assert ssim(b, a) == pytest.approx(ssim(a, b), abs=1e-6)


def test_a_reference_gives_what_comparing_alone_gives(pictures):
    a, b = pictures
    kept = a.copy(), b.copy()
    reference = Reference.of(b)
    for _ in range(2):  # nothing of one comparison is left for the next
        assert (reference.mse(a), reference.ssim(a)) == (mse(a, b), ssim(a, b))
        assert (reference.mse(b), reference.ssim(b)) == (0, pytest.approx(1, abs=1e-6))
    np.testing.assert_array_equal(a, kept[0])
    np.testing.assert_array_equal(b, kept[1])


def test_the_squared_error_is_of_what_a_screen_shows(pictures):
    a, b = pictures
    wanted = np.mean((np.clip(a, 0, 1).astype(np.float64) - np.clip(b, 0, 1)) ** 2)
    assert mse(a, b) == pytest.approx(wanted, rel=1e-6)
    assert mse(np.full_like(a, 7), np.full_like(a, 1)) == 0


def test_equal_pictures_have_the_largest_psnr(pictures):
    a, _ = pictures
    assert psnr(mse(a, a)) == PSNR_CAP == psnr(1e-30)
    assert psnr(1e-4) == pytest.approx(40)
