"""All numba kernels of the CPU renderer: projection, binning, blending, their gradients, usage statistics.

One file on purpose, though it is long: numba's cache does not notice edits in imported files.

N Gaussians, V visible ones front to back, M (Gaussian, tile) pairs, H x W pixels, tiles of 16 x 16.

A projected Gaussian has a form that needs no float32 determinant: with d = dx + shear * dy,
power = -(peak * d^2 + fall * dy^2) / 2, where peak = Syy / det, shear = -Sxy / Syy, fall = 1 / Syy (the Cholesky form
of the inverse covariance). With reach = ln(255 opacity), alpha = exp(reach + power) / 255, so alpha >= 1/255 where
reach + power >= 0. Pixel semantics are gsplat's: centres at +0.5, alpha at most 0.999, blending stops before
transmittance would fall to 1e-4, 0.3 px^2 is added to the covariance.

Loops over pixels are in float32 throughout: a whole number that numba reads as int64 would turn them into float64 and
halve the speed (`f4` is around every one of them), and so would a branch or a float maximum, which do not vectorise.

Columns of `flat` (N, 12): 0-1 pixel position, 2 peak, 3 shear, 4 fall, 5 reach, 6-8 r g b, 9-10 half width and
height of the ellipse alpha >= 1/255, 11 opacity. Columns of `pairs` (M, 12) and `grads` (N, 12) of the backward pass:
0-2 r g b, 3 reach, 4-5 position, 6 peak, 7 shear, 8 fall, then 9-10 absolute position gradients (or statistics).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit, prange

from airgs_codec.scene.gaussians import SH_C0

TILE_SIDE = 16
TILE_PIXELS = TILE_SIDE * TILE_SIDE
ROW_CHUNKS, BIN_CHUNKS = 64, 16  # of Gaussians that threads project, and sort into tiles, side by side
# Never nnan or ninf: they would delete the comparisons that keep NaN and Inf out.
FAST = {"reassoc", "contract", "arcp", "nsz", "afn"}
INNER: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}  # of functions that kernels alone call
f4 = np.float32

# Real spherical harmonics of bands 1 to 3, with the signs of the INRIA files.
SH_C1 = 0.4886025119029199
C20, C22 = 1.0925484305920792, 0.31539156525252005
SH_C2 = C20, C21, C22, C23, C24 = C20, -C20, C22, -C20, C20 / 2
C30, C31, C32, C33 = -0.5900435899266435, 2.890611442640554, -0.4570457994644658, 0.3731763325901154
SH_C3 = C30, C31, C32, C33, C34, C35, C36 = C30, C31, C32, C33, C32, C31 / 2, C30

# exp(e) / 255 on [0, ln 255] as p(e)^8 with p of degree 5: relative error below 2e-6 in float32.
_c = np.polynomial.chebyshev.Chebyshev.interpolate(lambda e: np.exp((e - np.log(255)) / 8), 5, domain=[0, 5.6])
E0, E1, E2, E3, E4, E5 = (f4(v) for v in _c.convert(kind=np.polynomial.Polynomial).coef)
ALPHA_MAX = f4(0.999)
T_MIN = f4(1e-4)
LINEAR_MARGIN = 0.15  # of the picture, on each side, in which projections are still linearised in their own place


@njit(fastmath=FAST, **INNER)
def sh_basis(deg, x, y, z, b):
    """Basis values in direction (x, y, z), unit length, into b (16,)."""
    b[0] = SH_C0
    if deg > 0:
        b[1], b[2], b[3] = -SH_C1 * y, SH_C1 * z, -SH_C1 * x
    if deg > 1:
        xx, yy, zz = x * x, y * y, z * z
        b[4] = C20 * x * y
        b[5] = C21 * y * z
        b[6] = C22 * (2.0 * zz - xx - yy)
        b[7] = C23 * x * z
        b[8] = C24 * (xx - yy)
        if deg > 2:
            b[9] = C30 * y * (3 * xx - yy)
            b[10] = C31 * x * y * z
            b[11] = C32 * y * (4 * zz - xx - yy)
            b[12] = C33 * z * (2 * zz - 3 * xx - 3 * yy)
            b[13] = C34 * x * (4 * zz - xx - yy)
            b[14] = C35 * z * (xx - yy)
            b[15] = C36 * x * (xx - 3 * yy)


@njit(fastmath=FAST, **INNER)
def sh_basis_grad(deg, x, y, z, basis):
    """Derivatives of the basis by x, y and z into rows 1 to 3 of basis (4, 16)."""
    dx, dy, dz = basis[1], basis[2], basis[3]
    dx[0], dy[0], dz[0] = 0.0, 0.0, 0.0
    if deg > 0:
        dx[1], dy[1], dz[1] = 0.0, -SH_C1, 0.0
        dx[2], dy[2], dz[2] = 0.0, 0.0, SH_C1
        dx[3], dy[3], dz[3] = -SH_C1, 0.0, 0.0
    if deg > 1:
        dx[4], dy[4], dz[4] = C20 * y, C20 * x, 0.0
        dx[5], dy[5], dz[5] = 0.0, C21 * z, C21 * y
        dx[6], dy[6], dz[6] = -2 * C22 * x, -2 * C22 * y, 4 * C22 * z
        dx[7], dy[7], dz[7] = C23 * z, 0.0, C23 * x
        dx[8], dy[8], dz[8] = 2 * C24 * x, -2 * C24 * y, 0.0
    if deg > 2:
        xx, yy, zz = x * x, y * y, z * z
        dx[9], dy[9], dz[9] = C30 * 6 * x * y, C30 * (3 * xx - 3 * yy), 0.0
        dx[10], dy[10], dz[10] = C31 * y * z, C31 * x * z, C31 * x * y
        dx[11], dy[11], dz[11] = -2 * C32 * x * y, C32 * (4 * zz - xx - 3 * yy), 8 * C32 * y * z
        dx[12], dy[12], dz[12] = -6 * C33 * x * z, -6 * C33 * y * z, C33 * (6 * zz - 3 * xx - 3 * yy)
        dx[13], dy[13], dz[13] = C34 * (4 * zz - 3 * xx - yy), -2 * C34 * x * y, 8 * C34 * x * z
        dx[14], dy[14], dz[14] = 2 * C35 * x * z, -2 * C35 * y * z, C35 * (xx - yy)
        dx[15], dy[15], dz[15] = C36 * (3 * xx - 3 * yy), -6 * C36 * x * y, 0.0


@njit(fastmath=FAST, **INNER)
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(fastmath=FAST, **INNER)
def _times(a, b):
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


@njit(fastmath=FAST, **INNER)
def _column(matrix, k):
    return matrix[0][k], matrix[1][k], matrix[2][k]


@njit(fastmath=FAST, **INNER)
def _row_by(a, matrix):
    """Return a row vector times a matrix of three rows."""
    return _dot(a, _column(matrix, 0)), _dot(a, _column(matrix, 1)), _dot(a, _column(matrix, 2))


@njit(fastmath=FAST, **INNER)
def _rotation(w, x, y, z):
    """Return rows of the rotation matrix of a unit quaternion."""
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


@njit(**INNER)
def _lens(view, intrinsics, W, H):
    """Return what projections of a camera need: focal lengths, bounds of u and v in which J is taken, centre.

    The bounds lie 15 % of the picture outside it, as in gsplat: the linearisation blows up at grazing angles.
    """
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    lens = np.empty(9, np.float64)
    lens[0], lens[1] = fx, fy
    lens[2], lens[3] = -cx / fx - LINEAR_MARGIN * W / fx, (W - cx) / fx + LINEAR_MARGIN * W / fx
    lens[4], lens[5] = -cy / fy - LINEAR_MARGIN * H / fy, (H - cy) / fy + LINEAR_MARGIN * H / fy
    for a in range(3):  # camera centre: -R^T t
        lens[6 + a] = -(view[0, a] * view[0, 3] + view[1, a] * view[1, 3] + view[2, a] * view[2, 3])
    return lens


@njit(inline="always")
def _three(values, i):
    """Return the first three numbers of a row, in float64."""
    return float(values[i, 0]), float(values[i, 1]), float(values[i, 2])


@njit(**INNER)
def _put(table, i, values):
    for c in range(len(values)):
        table[i, c] = values[c]


@njit(fastmath=FAST, **INNER)
def _see(view, row, p):
    """One coordinate of a point in camera space."""
    return _dot(view[row], p) + view[row, 3]


@njit(fastmath=FAST, **INNER)
def _unit(quaternions, i):
    """Unit quaternion of a row and 1 / its length; a zero one (or one too short to tell) is identity with 0.

    With NaN or Inf in it the reciprocal is NaN, which the caller's comparison culls. The square of a length past 1e19
    is infinite in float32, so that long ones are shortened first.
    """
    w, x = float(quaternions[i, 0]), float(quaternions[i, 1])
    y, z = float(quaternions[i, 2]), float(quaternions[i, 3])
    square = w * w + x * x + y * y + z * z
    if not (square < math.inf):
        if not (abs(w) < math.inf and abs(x) < math.inf and abs(y) < math.inf and abs(z) < math.inf):
            return 1.0, 0.0, 0.0, 0.0, math.nan
        largest = max(max(abs(w), abs(x)), max(abs(y), abs(z)))
        w, x, y, z = w / largest, x / largest, y / largest, z / largest
        inv = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
        return w * inv, x * inv, y * inv, z * inv, inv / largest
    if not (square > 1e-24):  # no direction to read, as in `scene.frames`: q / |q| would be 0 / 0
        return 1.0, 0.0, 0.0, 0.0, 0.0
    inv = 1.0 / math.sqrt(square)
    return w * inv, x * inv, y * inv, z * inv, inv


@njit(fastmath=FAST, **INNER)
def _jacobian(lens, view, u, v, iz):
    """u and v bounded, and the rows of J R, the derivative of the pixel position by the world position (EWA)."""
    uc = min(max(u, lens[2]), lens[3])
    vc = min(max(v, lens[4]), lens[5])
    j00, j02 = lens[0] * iz, -lens[0] * uc * iz
    j11, j12 = lens[1] * iz, -lens[1] * vc * iz
    t0 = j00 * view[0, 0] + j02 * view[2, 0], j00 * view[0, 1] + j02 * view[2, 1], j00 * view[0, 2] + j02 * view[2, 2]
    t1 = j11 * view[1, 0] + j12 * view[2, 0], j11 * view[1, 1] + j12 * view[2, 1], j11 * view[1, 2] + j12 * view[2, 2]
    return uc, vc, t0, t1


@njit(fastmath=FAST, **INNER)
def _direction(lens, p):
    """Unit vector from the camera to a point, and 1 / the distance; 0, not NaN, for a point on the camera centre."""
    dx, dy, dz = p[0] - lens[6], p[1] - lens[7], p[2] - lens[8]
    dn = 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz + 1e-30)
    return dx * dn, dy * dn, dz * dn, dn


@njit(fastmath=FAST, **INNER)
def _colour(deg, lens, p, sh, i, b):
    """Unclamped colour of a row seen from the camera; b (16,) is scratch."""
    x, y, z, _ = _direction(lens, p)
    sh_basis(deg, x, y, z, b)
    c0 = c1 = c2 = 0.5
    for k in range((deg + 1) * (deg + 1)):
        c0, c1, c2 = c0 + b[k] * sh[i, k, 0], c1 + b[k] * sh[i, k, 1], c2 + b[k] * sh[i, k, 2]
    return c0, c1, c2


@njit(fastmath=FAST, **INNER)
def _colour_gradient(deg, lens, p, sh, i, g, basis, grad_sh):
    """Gradient of a row's colour by its coefficients, into grad_sh, and by its mean, returned; basis (4, 16)."""
    nk = (deg + 1) * (deg + 1)
    ux, uy, uz, dn = _direction(lens, p)
    sh_basis(deg, ux, uy, uz, basis[0])
    for k in range(nk):
        grad_sh[i, k, 0] = basis[0, k] * g[0]
        grad_sh[i, k, 1] = basis[0, k] * g[1]
        grad_sh[i, k, 2] = basis[0, k] * g[2]
    if deg == 0:
        return 0.0, 0.0, 0.0
    sh_basis_grad(deg, ux, uy, uz, basis)
    hx = hy = hz = 0.0
    for k in range(1, nk):
        c = _dot(g, sh[i, k])
        hx += c * basis[1, k]
        hy += c * basis[2, k]
        hz += c * basis[3, k]
    dot = hx * ux + hy * uy + hz * uz
    return (hx - dot * ux) * dn, (hy - dot * uy) * dn, (hz - dot * uz) * dn


@njit(parallel=True, nogil=True, fastmath=FAST, cache=True, error_model="numpy")
def project(scene, camera, drawn, flat, key, tiles):
    """Project every Gaussian; what is culled keeps tiles = 0 and the largest key.

    scene: means (N, 3), quaternions (N, 4), scales (N, 3), opacities (N,), sh (N, K + 1, 3), its degree -> flat, key
    (depth bits, row), tiles (those of the `drawn` (tiles,) that a Gaussian touches). In float64: only N of them.
    Comparisons are written so that NaN and Inf are culled.
    """
    means, quaternions, scales, opacities, sh, deg = scene
    view, intrinsics, W, H, near, far, eps2d = camera
    N = means.shape[0]
    lens = _lens(view, intrinsics, W, H)
    tiles_x, tiles_y = (W + TILE_SIDE - 1) // TILE_SIDE, (H + TILE_SIDE - 1) // TILE_SIDE
    for ch in prange(ROW_CHUNKS):
        b = np.empty(16, np.float64)
        for i in range(ch * N // ROW_CHUNKS, (ch + 1) * N // ROW_CHUNKS):
            tiles[i] = 0
            key[i] = np.uint64(0xFFFFFFFFFFFFFFFF)
            p = _three(means, i)
            z = _see(view, 2, p)
            if not (z > near and z < far):
                continue
            op = float(opacities[i])
            if not (op * 255.0 > 1.0):
                continue
            w, qx, qy, qz, inv = _unit(quaternions, i)
            if not (inv >= 0.0):
                continue
            rotation = _rotation(w, qx, qy, qz)
            iz = 1.0 / z
            u, v = _see(view, 0, p) * iz, _see(view, 1, p) * iz
            _, _, t0, t1 = _jacobian(lens, view, u, v, iz)
            scale = _three(scales, i)
            m0, m1 = _times(_row_by(t0, rotation), scale), _times(_row_by(t1, rotation), scale)
            sxx0, syy0, sxy = _dot(m0, m0), _dot(m1, m1), _dot(m0, m1)
            # Cauchy-Binet: no cancellation for needles
            minors = m0[0] * m1[1] - m0[1] * m1[0], m0[0] * m1[2] - m0[2] * m1[0], m0[1] * m1[2] - m0[2] * m1[1]
            det = _dot(minors, minors) + eps2d * (sxx0 + syy0) + eps2d * eps2d
            sxx, syy = sxx0 + eps2d, syy0 + eps2d
            if not (det > 0.0 and det < 1e30):
                continue
            A, beta, kap, t = syy / det, -sxy / syy, 1.0 / syy, math.log(255.0 * op)
            hx, hy = math.sqrt(2.0 * t * sxx), math.sqrt(2.0 * t * syy)
            mx, my = lens[0] * u + intrinsics[2], lens[1] * v + intrinsics[3]
            if not (mx + hx > 0.0 and mx - hx < W and my + hy > 0.0 and my - hy < H):
                continue
            c0, c1, c2 = _colour(deg, lens, p, sh, i, b)
            if not (abs(c0) + abs(c1) + abs(c2) < 1e6):
                continue
            _put(flat, i, (mx, my, A, beta, kap, t, max(c0, 0.0), max(c1, 0.0), max(c2, 0.0), hx, hy, np.float64(op)))
            key[i] = (np.uint64(np.float32(z).view(np.uint32)) << np.uint64(32)) | np.uint64(i)
            tiles[i] = _ntiles(flat, i, drawn, tiles_x, tiles_y)
            if tiles[i] == 0:
                key[i] = np.uint64(0xFFFFFFFFFFFFFFFF)


@njit(inline="always")
def _ellipse(flat, i):
    """Position x and y, peak, shear, fall and reach of a projected Gaussian."""
    return flat[i, 0], flat[i, 1], flat[i, 2], flat[i, 3], flat[i, 4], flat[i, 5]


@njit(inline="always")
def _rows(flat, i, tiles_y):
    """Tile rows [a, b) that the ellipse touches."""
    y0, y1 = flat[i, 1] - flat[i, 10], flat[i, 1] + flat[i, 10]
    a = int(max(0.0, min(y0, 1e6)) // TILE_SIDE)
    b = int(max(-1.0, min(y1, 1e6)) // TILE_SIDE) + 1
    return a, min(b, tiles_y)


@njit(inline="always")
def _xrange(flat, i, ty, tiles_x):
    """Tiles [x0, x1) of tile row ty that the ellipse alpha >= 1/255 touches, exact for that band of rows."""
    mx, my, A, be, ka, t = _ellipse(flat, i)
    hx, hy = flat[i, 9], flat[i, 10]
    # ellipse x(y) = mx - beta*dy +- sqrt(2(t-.5 k dy^2)/A)
    lo = max(ty * TILE_SIDE + 0.5 - my, -hy)
    hi = min(ty * TILE_SIDE + TILE_SIDE - 0.5 - my, hy)
    if lo > hi:
        return 0, 0
    # y offset of the right-most point: dy* = -sign: derivative zero -> dy = -beta*Syy.. (scaled)
    ys = -be * (1.0 / ka) * 2.0 * t / hx if hx > 0 else 0.0
    s1 = math.sqrt(max(0.0, 2.0 * (t - 0.5 * ka * lo * lo) / A))
    s2 = math.sqrt(max(0.0, 2.0 * (t - 0.5 * ka * hi * hi) / A))
    xr = max(-be * lo + s1, -be * hi + s2)
    xl = min(-be * lo - s1, -be * hi - s2)
    if lo < ys and ys < hi:
        xr = hx
    if lo < -ys and -ys < hi:
        xl = -hx
    x0, x1 = mx + xl - 0.5, mx + xr - 0.5  # pixel index range
    if x1 < 0 or x0 > tiles_x * TILE_SIDE:
        return 0, 0
    # 1e-3 px for rounding: a tile too many is tried, never one too few.
    a = int(max(0.0, math.ceil(x0 - 1e-3))) // TILE_SIDE
    b = int(min(float(tiles_x * TILE_SIDE - 1), math.floor(x1 + 1e-3))) // TILE_SIDE + 1
    return a, b


@njit(**INNER)
def _ntiles(flat, i, drawn, tiles_x, tiles_y):
    """Tiles that the ellipse touches, of those that are drawn."""
    a, b = _rows(flat, i, tiles_y)
    n = 0
    for ty in range(a, b):
        x0, x1 = _xrange(flat, i, ty, tiles_x)
        for tx in range(x0, x1):
            n += int(drawn[ty * tiles_x + tx])
    return n


@njit(parallel=True, nogil=True, cache=True, error_model="numpy")
def bin_tiles(flat, order, first_pair, drawn, tiles_x, tiles_y):
    """Pairs of (Gaussian, tile), tile by tile, front to back inside a tile: a counting sort.

    order (V,): visible rows front to back; first_pair (V + 1,): slot of each one's first pair, Gaussian by Gaussian;
    drawn (tiles,): whether a tile has any.
    Returns tile_start (tiles + 1,), ids (M,) rows tile by tile, slots (M,) place in `ids` of a Gaussian's pairs.
    """
    V = order.shape[0]
    M = first_pair[V]
    count = tiles_x * tiles_y
    ids = np.empty(M, np.int32)
    slots = np.empty(M, np.int32)  # first the tile of each pair, then its place
    place = np.zeros((BIN_CHUNKS, count), np.int64)
    for ch in prange(BIN_CHUNKS):
        for k in range(ch * V // BIN_CHUNKS, (ch + 1) * V // BIN_CHUNKS):
            i = order[k]
            q = first_pair[k]
            a, b = _rows(flat, i, tiles_y)
            for ty in range(a, b):
                x0, x1 = _xrange(flat, i, ty, tiles_x)
                for tx in range(x0, x1):
                    tile = ty * tiles_x + tx
                    if not drawn[tile]:
                        continue
                    slots[q] = tile
                    place[ch, tile] += 1
                    q += 1
    tile_start = np.zeros(count + 1, np.int64)
    at = 0
    for tile in range(count):
        for ch in range(BIN_CHUNKS):
            pairs = place[ch, tile]
            place[ch, tile] = at
            at += pairs
        tile_start[tile + 1] = at
    for ch in prange(BIN_CHUNKS):
        for k in range(ch * V // BIN_CHUNKS, (ch + 1) * V // BIN_CHUNKS):
            for q in range(first_pair[k], first_pair[k + 1]):
                tile = slots[q]
                p = place[ch, tile]
                place[ch, tile] = p + 1
                ids[p] = order[k]
                slots[q] = p
    return tile_start, ids, slots


@njit(inline="always", fastmath=FAST)
def _alpha(e):
    """exp(e) / 255 for e in [0, ln 255]; outside, where nothing is drawn, it may be any number."""
    p = E0 + e * (E1 + e * (E2 + e * (E3 + e * (E4 + e * E5))))
    p = p * p
    p = p * p
    return p * p


@njit(inline="always", fastmath=FAST)
def _start_tile(tile, tiles_x, W, H, buf):
    """First column and row of the picture in a tile, and how many of both it has.

    Fills planes 0 to 2 of the tile's scratch: transmittance, 0 outside the picture, then x and y of the pixel centres.
    """
    left, top = tile % tiles_x * TILE_SIDE, tile // tiles_x * TILE_SIDE
    for k in range(TILE_PIXELS):
        x, y = f4(left) + f4(k % TILE_SIDE) + f4(0.5), f4(top) + f4(k // TILE_SIDE) + f4(0.5)
        buf[k] = f4(1.0) if x < W and y < H else f4(0.0)
        buf[TILE_PIXELS + k], buf[2 * TILE_PIXELS + k] = x, y
    return left, top, min(TILE_SIDE, W - left), min(TILE_SIDE, H - top)


@njit(inline="always", fastmath=FAST)
def _tile_rows(flat, i, y):
    """Return rows [a, b) of a tile with pixels of alpha >= 1/255; a <= b."""
    top = flat[i, 1] - f4(y) - f4(0.5)  # of the centre, in rows of the tile
    a = math.ceil(min(max(top - flat[i, 10], f4(0.0)), f4(TILE_SIDE)))
    b = math.floor(max(min(top + flat[i, 10], f4(TILE_SIDE - 1.0)), f4(-1.0))) + 1
    return a, max(a, b)


@njit(inline="always", fastmath=FAST)
def _blend_pixel(row, q, mx, my, hA, be, hk, t):
    """Blend a Gaussian into pixel q of some rows of a tile's scratch; a finished pixel stays so by a minus sign.

    Returns dy, d, alpha before and after it is bounded, the transmittance before, and the weight or 0.
    """
    dy = row[2 * TILE_PIXELS + q] - my
    d = row[TILE_PIXELS + q] - mx + be * dy
    e = t - hk * dy * dy - hA * d * d
    ar = _alpha(e)
    al = min(ar, ALPHA_MAX)
    T = row[q]
    te = max(T, f4(0.0))
    nT = te * (f4(1.0) - al)
    inside = e >= f4(0.0)
    ok = inside and nT > T_MIN
    row[q] = nT if ok else (-abs(T) if inside else T)
    return dy, d, ar, al, te, al * te if ok else f4(0.0)


@njit(inline="always", fastmath=FAST)
def _all_finished(buf):
    """Return whether no pixel of a tile lets light through any more."""
    most = f4(0.0)
    for k in range(TILE_PIXELS):
        most = max(most, buf[k])
    return most <= f4(0.0)


@njit(**INNER)
def _bits(x):
    """Return the bits of a float32; from 0 on they are ordered as the numbers are, and their maximum vectorises."""
    return np.float32(x).view(np.int32)


@njit(**INNER)
def _from_bits(x):
    """Inverse of `_bits`."""
    return np.int32(x).view(np.float32)


@njit(parallel=True, nogil=True, fastmath=FAST, cache=True, error_model="numpy", boundscheck=False)
def blend(tiles, background, rgb, transmittance, blended):
    """Blend the tiles of `tile_order`: rgb (H, W, 3), transmittance (H, W), blended (tiles,) pairs visited.

    The pixels of all rows that a Gaussian touches are one loop without branches, which compiles to vectors.
    """
    flat, tile_start, ids, tile_order, tiles_x, _ = tiles
    H, W = transmittance.shape
    for tt in prange(tile_order.shape[0]):
        tile = tile_order[tt]
        buf = np.zeros(6 * TILE_PIXELS, np.float32)  # T, x, y, r, g, b
        x, y, ww, hh = _start_tile(tile, tiles_x, W, H, buf)
        a = tile_start[tile]
        visited = tile_start[tile + 1] - a
        for j in range(a, a + visited):
            i = ids[j]
            mx, my, A, be, ka, t = _ellipse(flat, i)
            hA, hk = f4(0.5) * A, f4(0.5) * ka
            r, g, bl = flat[i, 6], flat[i, 7], flat[i, 8]
            ya, yb = _tile_rows(flat, i, y)
            row = buf[ya * TILE_SIDE :]
            for q in range((yb - ya) * TILE_SIDE):
                _, _, _, _, _, w = _blend_pixel(row, q, mx, my, hA, be, hk, t)
                row[3 * TILE_PIXELS + q] += w * r
                row[4 * TILE_PIXELS + q] += w * g
                row[5 * TILE_PIXELS + q] += w * bl
            if (j - a) % 8 == 7 and _all_finished(buf):
                visited = j - a + 1
                break
        blended[tile] = visited
        for yy in range(hh):
            for xx in range(ww):
                o = yy * TILE_SIDE + xx
                T = abs(buf[o])
                transmittance[y + yy, x + xx] = T
                for c in range(3):
                    rgb[y + yy, x + xx, c] = buf[(3 + c) * TILE_PIXELS + o] + T * background[c]


@njit(parallel=True, nogil=True, fastmath=FAST, cache=True, error_model="numpy", boundscheck=False)
def blend_gradient(tiles, rgb, transmittance, blended, grad_rgb, grad_transmittance, statistics, pairs):
    """Gradients of every pair, front to back with the arithmetic of the forward pass.

    S, what lies behind a pixel, starts as the finished sum and loses each pair's part: no division chain by
    1 - alpha. grad_transmittance: dL / d(final transmittance), background excluded. With `statistics` True, not None,
    columns 9 to 11 of a pair are the sum and the maximum of its blending weight alpha T, and the pixels where it is
    blended; it is compiled apart.
    """
    flat, tile_start, ids, tile_order, tiles_x, _ = tiles
    H, W = transmittance.shape
    for tt in prange(tile_order.shape[0]):
        tile = tile_order[tt]
        a = tile_start[tile]
        n = blended[tile]
        pairs[a + n : tile_start[tile + 1]] = f4(0.0)
        if n == 0:
            continue
        buf = np.zeros(7 * TILE_PIXELS, np.float32)  # T, x, y, S, gR, gG, gB
        x, y, ww, hh = _start_tile(tile, tiles_x, W, H, buf)
        for yy in range(hh):
            for xx in range(ww):
                o = yy * TILE_SIDE + xx
                g, seen = grad_rgb[y + yy, x + xx], rgb[y + yy, x + xx]
                T = transmittance[y + yy, x + xx]
                buf[3 * TILE_PIXELS + o] = _dot(g, seen) + grad_transmittance[y + yy, x + xx] * T
                for c in range(3):
                    buf[(4 + c) * TILE_PIXELS + o] = g[c]
        for j in range(a, a + n):
            i = ids[j]
            mx, my, A, be, ka, t = _ellipse(flat, i)
            hA, hk = f4(0.5) * A, f4(0.5) * ka
            r, g, bl = flat[i, 6], flat[i, 7], flat[i, 8]
            sr = sg = sb = m0 = m1 = m2 = m0y = m0yy = m1y = c9 = c10 = c11 = f4(0.0)
            peak = np.int32(0)
            ya, yb = _tile_rows(flat, i, y)
            row = buf[ya * TILE_SIDE :]
            for q in range((yb - ya) * TILE_SIDE):
                dy, d, ar, al, te, w = _blend_pixel(row, q, mx, my, hA, be, hk, t)
                gr, gg, gb = row[4 * TILE_PIXELS + q], row[5 * TILE_PIXELS + q], row[6 * TILE_PIXELS + q]
                gc = gr * r + gg * g + gb * bl
                S = row[3 * TILE_PIXELS + q] - w * gc
                row[3 * TILE_PIXELS + q] = S
                da = te * gc - S / (f4(1.0) - al)
                v = al * da if (w > f4(0.0) and ar <= ALPHA_MAX) else f4(0.0)
                vd, vy = v * d, v * dy
                sr, sg, sb = sr + w * gr, sg + w * gg, sb + w * gb
                m0, m1, m2 = m0 + v, m1 + vd, m2 + vd * d
                m0y, m0yy, m1y = m0y + vy, m0yy + vy * dy, m1y + vd * dy
                if statistics is None:
                    c9 += abs(vd * A)
                    c10 += abs(vd * A * be + vy * ka)
                else:
                    c9 += w
                    peak = max(peak, _bits(w))
                    c11 += f4(1.0) if w > f4(0.0) else f4(0.0)
            if statistics is not None:
                c10 = _from_bits(peak)
            by_place = A * m1, A * be * m1 + ka * m0y
            by_form = f4(-0.5) * m2, -A * m1y, f4(-0.5) * m0yy
            _put(pairs, j, (sr, sg, sb, m0, *by_place, *by_form, c9, c10, c11))


@njit(parallel=True, nogil=True, fastmath=FAST, cache=True, error_model="numpy")
def sum_pairs(order, first_pair, slots, wanted, pairs, grads):
    """Add each wanted Gaussian's pairs to `grads` in fixed order: the same result with any number of threads."""
    for k in prange(order.shape[0]):
        i = order[k]
        if wanted[i]:
            for q in range(first_pair[k], first_pair[k + 1]):
                for c in range(12):
                    grads[i, c] += pairs[slots[q], c]


@njit(parallel=True, nogil=True, fastmath=FAST, cache=True, error_model="numpy")
def project_gradient(scene, camera, flat, vis, wanted, grads, gradients):
    """Gradients of the attributes of wanted visible rows from those of the projection; buffers are zeroed before.

    A zero quaternion has zero gradient, as it was read as identity.
    """
    means, quaternions, scales, opacities, sh, deg = scene
    view, intrinsics, W, H, _, _, _ = camera
    grad_means, grad_quaternions, grad_scales, grad_opacities, grad_sh = gradients
    M = vis.shape[0]
    lens = _lens(view, intrinsics, W, H)
    fx, fy = lens[0], lens[1]
    for ch in prange(ROW_CHUNKS):
        basis = np.empty((4, 16), np.float64)
        for kk in range(ch * M // ROW_CHUNKS, (ch + 1) * M // ROW_CHUNKS):
            i = vis[kk]
            if not wanted[i]:
                continue
            p = _three(means, i)
            g0 = float(grads[i, 0]) if flat[i, 6] > 0 else 0.0
            g1 = float(grads[i, 1]) if flat[i, 7] > 0 else 0.0
            g2 = float(grads[i, 2]) if flat[i, 8] > 0 else 0.0
            by_colour = _colour_gradient(deg, lens, p, sh, i, (g0, g1, g2), basis, grad_sh)
            grad_opacities[i] = grads[i, 3] / float(opacities[i])  # reach = ln(255 opacity)
            x, y, z = _see(view, 0, p), _see(view, 1, p), _see(view, 2, p)
            w, qx, qy, qz, inv = _unit(quaternions, i)
            rotation = _rotation(w, qx, qy, qz)
            iz = 1.0 / z
            u, v = x * iz, y * iz
            uc, vc, t0, t1 = _jacobian(lens, view, u, v, iz)
            scale = _three(scales, i)
            shape = _times(rotation[0], scale), _times(rotation[1], scale), _times(rotation[2], scale)
            m0, m1 = _row_by(t0, shape), _row_by(t1, shape)
            A, be, ka = float(flat[i, 2]), float(flat[i, 3]), float(flat[i, 4])
            gmx, gmy = float(grads[i, 4]), float(grads[i, 5])
            gA, gB, gK = float(grads[i, 6]), float(grads[i, 7]), float(grads[i, 8])
            gsxx = -gA * A * A
            gsxy = -2.0 * be * A * A * gA - ka * gB
            gsyy = -be * be * A * A * gA - be * ka * gB - ka * ka * gK
            # dM = (dS + dS^T) M
            a0 = 2 * gsxx * m0[0] + gsxy * m1[0], 2 * gsxx * m0[1] + gsxy * m1[1], 2 * gsxx * m0[2] + gsxy * m1[2]
            a1 = 2 * gsyy * m1[0] + gsxy * m0[0], 2 * gsyy * m1[1] + gsxy * m0[1], 2 * gsyy * m1[2] + gsxy * m0[2]
            # d(shape) = T^T dM
            d00, d01, d02 = t0[0] * a0[0] + t1[0] * a1[0], t0[0] * a0[1] + t1[0] * a1[1], t0[0] * a0[2] + t1[0] * a1[2]
            d10, d11, d12 = t0[1] * a0[0] + t1[1] * a1[0], t0[1] * a0[1] + t1[1] * a1[1], t0[1] * a0[2] + t1[1] * a1[2]
            d20, d21, d22 = t0[2] * a0[0] + t1[2] * a1[0], t0[2] * a0[1] + t1[2] * a1[1], t0[2] * a0[2] + t1[2] * a1[2]
            grad_scales[i, 0] = _dot((d00, d10, d20), _column(rotation, 0))
            grad_scales[i, 1] = _dot((d01, d11, d21), _column(rotation, 1))
            grad_scales[i, 2] = _dot((d02, d12, d22), _column(rotation, 2))
            s0, s1, s2 = scale
            d00, d10, d20 = d00 * s0, d10 * s0, d20 * s0
            d01, d11, d21 = d01 * s1, d11 * s1, d21 * s1
            d02, d12, d22 = d02 * s2, d12 * s2, d22 * s2
            gw = 2 * (-qz * d01 + qy * d02 + qz * d10 - qx * d12 - qy * d20 + qx * d21)
            gqx = 2 * (qy * d01 + qz * d02 + qy * d10 - 2 * qx * d11 - w * d12 + qz * d20 + w * d21 - 2 * qx * d22)
            gqy = 2 * (-2 * qy * d00 + qx * d01 + w * d02 + qx * d10 + qz * d12 - w * d20 + qz * d21 - 2 * qy * d22)
            gqz = 2 * (-2 * qz * d00 - w * d01 + qx * d02 + w * d10 - 2 * qz * d11 + qy * d12 + qx * d20 + qy * d21)
            dot = gw * w + gqx * qx + gqy * qy + gqz * qz
            along = (gw - dot * w) * inv, (gqx - dot * qx) * inv, (gqy - dot * qy) * inv, (gqz - dot * qz) * inv
            _put(grad_quaternions, i, along)
            # dT = dM shape^T
            e0 = _dot(a0, shape[0]), _dot(a0, shape[1]), _dot(a0, shape[2])
            e1 = _dot(a1, shape[0]), _dot(a1, shape[1]), _dot(a1, shape[2])
            gj00, gj02 = _dot(e0, view[0]), _dot(e0, view[2])
            gj11, gj12 = _dot(e1, view[1]), _dot(e1, view[2])
            giz = gj00 * fx + gj11 * fy - gj02 * fx * uc - gj12 * fy * vc
            gu, gv = gmx * fx, gmy * fy
            if u == uc:
                gu += -gj02 * fx * iz
            if v == vc:
                gv += -gj12 * fy * iz
            giz += gu * x + gv * y
            by_place = gu * iz, gv * iz, -giz * iz * iz
            for c in range(3):
                grad_means[i, c] = by_colour[c] + _dot(_column(view, c), by_place)
