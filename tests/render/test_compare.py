"""Quality of pictures beside definitions that go sample by sample, and two sources compared view by view."""

import gc
import weakref
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from airgs_codec.render.compare import compare, draw_frames, draw_once, draw_still, in_order
from tests import faces
from tests.faces import PSNR_CAP, Difference, Picture, Quality, delta_e, delta_e_metric, mse, pool, psnr, render
from tests.support.scenes import moving_frames
from tests.support.views import ring

SIDE, *OTHERS = ring(3, size=16)
WIDE = replace(SIDE, width=21, cx=10.5)
AHEAD = 4  # views that are measured while the next one is drawn


def plain_mse(a, b):
    """Mean squared error of (H, W, 3) pictures, sample by sample."""
    pairs = zip(*(np.clip(picture, 0, 1).ravel().tolist() for picture in (a, b)), strict=True)
    return sum((first - second) ** 2 for first, second in pairs) / a.size


def plain_ssim(a, b):
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


def plain_delta_e(a, b):
    """Mean CIEDE2000, pixel by pixel; colour-science sets how numpy prints where it is imported."""
    with np.printoptions():
        from colour import XYZ_to_Lab, sRGB_to_XYZ
        from colour.difference import delta_E_CIE2000
    pixels = zip(*(np.clip(picture, 0, 1).reshape(-1, 3).astype(float) for picture in (a, b)), strict=True)
    return np.mean([delta_E_CIE2000(*(XYZ_to_Lab(sRGB_to_XYZ(colour)) for colour in pair)) for pair in pixels])


def files(pictures):
    """A source that draws nothing: (H, W, 3) pictures by frame, whatever the camera."""
    return lambda frame, _: Picture.of(pictures[frame])


def constant(value, height=12, width=16):
    return np.full((height, width, 3), value, np.float32)


@pytest.fixture(params=[0.002, 0.05, 0.5])
def pictures(request):
    """A picture and a noisy one; both leave [0, 1], and the first is black in one corner."""
    ramp = np.linspace(-0.1, 1.1, 24 * 31 * 3).reshape(24, 31, 3)
    ramp[:12, :12] = 0
    noise = np.random.default_rng(0).normal(0, request.param, ramp.shape)
    return ramp.astype(np.float32), (ramp + noise).astype(np.float32)


def test_errors_and_similarity_are_those_of_what_a_screen_shows_and_nothing_is_left_for_the_next(pictures):
    before = [picture.copy() for picture in pictures]
    a, b = map(Picture.of, pictures)
    assert a.ssim(b) == pytest.approx(plain_ssim(*pictures), abs=1e-5)
    assert b.ssim(a) == pytest.approx(a.ssim(b), abs=1e-6)
    assert mse(*pictures) == pytest.approx(plain_mse(*pictures), rel=1e-6)
    assert mse(np.full_like(pictures[0], 7), np.full_like(pictures[0], 1)) == 0
    assert psnr(mse(pictures[0], pictures[0])) == PSNR_CAP == psnr(1e-30) and psnr(1e-4) == pytest.approx(40)
    for first, second in ((a, b), (b, a), (a, a)) * 2:
        assert Difference.of(first, second) == Difference.of(Picture.of(first.rgb), Picture.of(second.rgb))
    for picture, same in zip(pictures, before, strict=True):
        np.testing.assert_array_equal(picture, same)


def test_every_figure_of_every_view_is_that_of_its_definition():
    frames, others = moving_frames(60, 3), moving_frames(60, 3, seed=1)
    views = [(2, WIDE), (0, SIDE), (0, OTHERS[0]), (2, SIDE), (1, WIDE)]
    found = list(compare(draw_frames(frames.__getitem__), draw_frames(others.__getitem__), views, Difference.of))
    pairs = [[render(some[frame], camera).rgb for some in (frames, others)] for frame, camera in views]
    errors, whole = [plain_mse(*pair) for pair in pairs], pool(found)
    assert [d.mse for d in found] == pytest.approx(errors, rel=1e-5)
    assert [d.ssim for d in found] == pytest.approx([plain_ssim(*pair) for pair in pairs], abs=1e-5)
    assert [d.delta_e for d in found] == pytest.approx([plain_delta_e(*pair) for pair in pairs], rel=1e-4)
    assert whole.psnr == pytest.approx(-10 * np.log10(sum(errors) / 5)) and whole.psnr < np.mean([*map(psnr, errors)])
    assert whole.low == pytest.approx(np.quantile(-10 * np.log10(errors), 0.05))
    assert whole.ssim == pytest.approx(np.mean([d.ssim for d in found]))
    assert whole.delta_e == pytest.approx(np.mean([d.delta_e for d in found]))


@pytest.mark.parametrize(("wanted", "shown", "mse", "colour"), [
    *((same, same, 0.0, 0.0) for same in map(constant, (0.3, (0.2, 0.4, 0.6), 0.0))),
    (constant(0.0), constant(1.0), 1.0, 100.0),  # black and white: L* of 0 and 100
    (constant(-3.0), constant(9.0), 1.0, 100.0),  # no screen shows less than black or more than white
    (constant((1.0, 0, 0)), constant((0, 1.0, 0)), 2 / 3, 86.615),  # sRGB's red and green, by Sharma's formula
    (constant((0, 0, 1.0)), constant((1.0, 0, 0)), 2 / 3, 52.881),
    (constant(0.0, 1, 1), constant(0.0, 1, 1), 0.0, 0.0),
    (constant(0.25, 1, 1), constant(0.75, 1, 1), 0.25, None),
])  # fmt: skip
def test_extreme_pictures(wanted, shown, mse, colour):
    (found,) = compare(files([wanted]), files([shown]), [(0, SIDE)], Difference.of)
    same = mse == 0
    assert found.mse == pytest.approx(mse, abs=0) and (found.ssim == pytest.approx(1, abs=1e-6)) == same
    assert found.delta_e == pytest.approx(plain_delta_e(wanted, shown) if colour is None else colour, abs=0.01)
    if wanted.size > 3:  # the window of the definition is mirrored, which takes two pixels
        assert found.ssim == pytest.approx(plain_ssim(wanted, shown), abs=1e-5)
    decibels = PSNR_CAP if same else pytest.approx(-10 * np.log10(mse))
    assert pool([found]) == Quality(decibels, decibels, found.ssim, found.delta_e)


def test_a_part_of_the_pixels_stands_for_large_pictures():
    rng = np.random.default_rng(1)
    parts = [slice(i, i + 10) for i in range(0, 300, 10)]  # small enough: all their pixels
    assert 200 * 10 < 2048 < 200 * 300  # pixels whose colours are compared
    wholes, strips = [], []
    for _ in range(4):
        a = rng.random((200, 300, 3)).astype(np.float32)
        b = (a + rng.normal(size=a.shape) * 0.05).astype(np.float32)
        wholes.append(Picture.of(a).delta_e(Picture.of(b)))
        assert wholes[-1] == Picture.of(a[::6, ::6]).delta_e(Picture.of(b[::6, ::6]))
        strips += [Picture.of(a[:, part]).delta_e(Picture.of(b[:, part])) for part in parts]
    assert np.mean(wholes) == pytest.approx(np.mean(strips), rel=0.02)


def test_hues_that_are_opposite_differ_as_in_the_paper():
    """Rows of table 1 of Sharma et al. 2005 on both sides of where CIEDE2000 jumps, and grey, which has no hue."""
    a = np.array([[50, 2.49, -0.001], [50, 2.49, -0.001], [50, -0.001, 2.49], [50, -0.001, 2.49], [50, 0, 0]])
    b = np.array([[50, -2.49, 0.001], [50, -2.49, 0.0011], [50, 0.001, -2.49], [50, 0.0011, -2.49], [50, -1, 2]])
    np.testing.assert_allclose(delta_e(a, b), [7.1792, 7.2195, 4.8045, 4.7461, 2.3669], atol=5e-5)


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


def test_no_views_and_pictures_of_different_sizes_are_refused():
    with pytest.raises(faces.ConfigError, match="expected at least one"):
        compare(files([]), files([]), [], Picture.mse)
    for size, got in (((1, 1), "1x1"), ((12, 17), "17x12"), ((16, 12), "12x16")):
        shown = files([constant(0.5, *size)])
        with pytest.raises(faces.ConfigError, match=f"^frame 0, camera cam00: expected 16x12 pixels, got {got}$"):
            list(compare(files([constant(0.5)]), shown, [(0, SIDE)], Picture.mse))


def test_sources_are_asked_when_a_view_is_due_and_few_pictures_are_held():
    asked, held = [], []

    def show(name, frame, camera):
        asked.append((name, frame, camera))
        held.append(weakref.ref(picture := Picture.of(constant(frame / 8))))
        return picture

    views = [(4, SIDE), (1, WIDE), (4, SIDE)] * AHEAD
    found = compare(partial(show, "reference"), partial(show, "shown"), views, Picture.mse)
    assert asked == []
    for i, error in enumerate(found):
        due = views[: i + 1 + AHEAD]
        assert error == 0 and asked == [(name, *view) for view in due for name in ("reference", "shown")]
        assert sum(picture() is not None for picture in held) <= 2 * (AHEAD + 2)
    gc.collect()
    assert [picture() for picture in held] == [None] * len(asked)
    assert len(asked) == 2 * len(views)


def test_frames_are_read_once_for_all_views_that_follow_each_other_and_those_of_a_stream_in_order():
    frames, read = moving_frames(30, 6), []
    source, still = draw_frames(lambda frame: read.append(frame) or frames[frame]), draw_still(frames[3])
    for frame, camera in [(frame, camera) for frame in (3, 1, 3) for camera in (SIDE, *OTHERS)]:
        drawn = np.clip(render(frames[frame], camera).rgb, 0, 1)
        assert drawn.any() and np.array_equal(source(frame, camera).rgb, drawn)
        assert np.array_equal(still(frame, camera).rgb, drawn) == (frame == 3)
    assert read == [3, 1, 3] and np.array_equal(still(7, SIDE).rgb, still(0, SIDE).rgb)
    stream = in_order([1, 2, 5], iter([frames[1], frames[2], frames[5]]))
    assert stream(1) is frames[1] and stream(5) is frames[5]
    with pytest.raises(ValueError, match="shorter"):
        in_order([1, 2], iter(frames[:1]))(2)


def test_a_reference_is_drawn_once_for_all_that_is_compared_with_it():
    drawn, views = [], [(2, WIDE), (0, SIDE), (2, SIDE)]
    reference = draw_once(lambda *view: drawn.append(view) or Picture.of(constant(view[0] / 8)))
    for error in (0.125, 0.5):
        shown = files([constant(frame / 8 + error) for frame in range(3)])
        assert list(compare(reference, shown, views, Picture.mse)) == pytest.approx([error**2] * 3)
    assert drawn == views
