"""L1 and D-SSIM of two pictures with the gradient by the first, in two passes over rows.

H rows of n = 3 W interleaved samples. SSIM has an 11-tap Gaussian window of sigma 1.5 (Wang et al. 2004) over pictures
that are zero outside, as 3DGS has it. A row is filtered horizontally, then rows vertically; the gradient of a filtered
picture is the same filter of its gradient, because the window is symmetric.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from airgs_codec.render.cpu_kernels import FAST

f4 = np.float32

RADIUS = 5
_window = np.exp(-((np.arange(2 * RADIUS + 1) - RADIUS) ** 2) / (2 * 1.5**2))
W0, W1, W2, W3, W4, W5 = (f4(v) for v in (_window / _window.sum())[: RADIUS + 1])
C1, C2 = f4(0.01**2), f4(0.03**2)  # K1 and K2 of Wang et al. for a range of 1
PAD = 3 * RADIUS


@njit(inline="always", fastmath=FAST)
def _across(source, target, n):
    """Filter a row of n samples; source (n + 2 PAD,) has zeros on both sides."""
    for i in range(n):
        target[i] = (
            W0 * (source[i] + source[i + 30])
            + W1 * (source[i + 3] + source[i + 27])
            + W2 * (source[i + 6] + source[i + 24])
            + W3 * (source[i + 9] + source[i + 21])
            + W4 * (source[i + 12] + source[i + 18])
            + W5 * source[i + 15]
        )


@njit(inline="always", fastmath=FAST)
def _down(rows, y, n, target):
    """Filter down to row y; rows (H + 2 RADIUS, n) has zero rows above and below."""
    r0, r1, r2, r3, r4, r5 = rows[y], rows[y + 1], rows[y + 2], rows[y + 3], rows[y + 4], rows[y + 5]
    r6, r7, r8, r9, r10 = rows[y + 6], rows[y + 7], rows[y + 8], rows[y + 9], rows[y + 10]
    for i in range(n):
        target[i] = (
            W0 * (r0[i] + r10[i])
            + W1 * (r1[i] + r9[i])
            + W2 * (r2[i] + r8[i])
            + W3 * (r3[i] + r7[i])
            + W4 * (r4[i] + r6[i])
            + W5 * r5[i]
        )


@njit(parallel=True, fastmath=FAST, cache=True, error_model="numpy")
def window_moments(picture, mean, variance):
    """Windowed mean and variance of a picture (H, n), into arrays of that shape."""
    H, n = picture.shape
    rows = np.zeros((2, H + 2 * RADIUS, n), np.float32)
    for y in prange(H):
        padded = np.zeros((2, n + 2 * PAD), np.float32)
        for i in range(n):
            v = picture[y, i]
            padded[0, i + PAD] = v
            padded[1, i + PAD] = v * v
        _across(padded[0], rows[0, y + RADIUS], n)
        _across(padded[1], rows[1, y + RADIUS], n)
    for y in prange(H):
        _down(rows[0], y, n, mean[y])
        _down(rows[1], y, n, variance[y])
        for i in range(n):
            variance[y, i] -= mean[y, i] * mean[y, i]


@njit(parallel=True, fastmath=FAST, cache=True, error_model="numpy")
def l1_dssim(picture, truth, mean, variance, w_l1, w_dssim, rows, back, gradient, sums):
    """Gradient of w_l1 * mean |x - y| + w_dssim * (1 - mean SSIM) by x = picture (H, n), and sums over each row.

    mean, variance (H, n): of truth, by `window_moments`. rows, back (3, H + 2 RADIUS, n): scratch whose first and last
    RADIUS rows are zero and stay so. sums (H, 2): |x - y|, SSIM.
    """
    H, n = picture.shape
    g_ssim = f4(-w_dssim / (H * n))
    g_l1 = f4(w_l1 / (H * n))
    for y in prange(H):
        padded = np.zeros((3, n + 2 * PAD), np.float32)
        for i in range(n):
            v = picture[y, i]
            padded[0, i + PAD] = v
            padded[1, i + PAD] = v * v
            padded[2, i + PAD] = v * truth[y, i]
        for k in range(3):
            _across(padded[k], rows[k, y + RADIUS], n)
    for y in prange(H):
        moments = np.empty((3, n), np.float32)
        padded = np.zeros((3, n + 2 * PAD), np.float32)
        for k in range(3):
            _down(rows[k], y, n, moments[k])
        m0, m1, m2, mu, var = moments[0], moments[1], moments[2], mean[y], variance[y]
        p0, p1, p2 = padded[0], padded[1], padded[2]
        total = f4(0.0)
        for i in range(n):
            mx, my = m0[i], mu[i]
            vx, cov = m1[i] - mx * mx, m2[i] - mx * my
            a, b = f4(2.0) * mx * my + C1, f4(2.0) * cov + C2
            c, d = mx * mx + my * my + C1, vx + var[i] + C2
            inverse = f4(1.0) / (c * d)
            ssim = a * b * inverse
            total += ssim
            # Derivatives of SSIM by the windowed x, x^2 and x y; vx and cov depend on the first too.
            by_square = -ssim / d
            by_product = f4(2.0) * a * inverse
            by_mean = f4(2.0) * my * b * inverse - f4(2.0) * mx * (ssim / c + by_square) - my * by_product
            p0[i + PAD] = by_mean * g_ssim
            p1[i + PAD] = by_square * g_ssim
            p2[i + PAD] = by_product * g_ssim
        sums[y, 1] = total
        for k in range(3):
            _across(padded[k], back[k, y + RADIUS], n)
    for y in prange(H):
        moments = np.empty((3, n), np.float32)
        for k in range(3):
            _down(back[k], y, n, moments[k])
        m0, m1, m2 = moments[0], moments[1], moments[2]
        x, t, out = picture[y], truth[y], gradient[y]
        absolute = f4(0.0)
        for i in range(n):
            d = x[i] - t[i]
            absolute += abs(d)
            l1 = g_l1 if d > 0 else (-g_l1 if d < 0 else f4(0.0))
            out[i] = m0[i] + f4(2.0) * x[i] * m1[i] + t[i] * m2[i] + l1
        sums[y, 0] = absolute
