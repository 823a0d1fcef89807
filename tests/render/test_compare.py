"""Two sources of pictures compared view by view, beside definitions that go sample by sample."""

import gc
import weakref
from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.render.compare import AHEAD, compare, draw_frames, draw_once, draw_still, in_order
from tests.faces import PSNR_CAP, ConfigError, Difference, Picture, Quality, pool, psnr, render
from tests.support.plain_metrics import plain_mse, plain_ssim
from tests.support.scenes import moving_frames
from tests.support.views import coloured_cloud, ring

SIDE, *OTHERS = ring(3, size=24)
WIDE = replace(SIDE, width=31, cx=15.5)


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


def test_every_figure_of_every_view_is_that_of_its_definition():
    frames, others = moving_frames(60, 3), moving_frames(60, 3, seed=1)
    views = [(2, WIDE), (0, SIDE), (0, OTHERS[0]), (2, SIDE), (1, WIDE)]
    found = list(compare(draw_frames(frames.__getitem__), draw_frames(others.__getitem__), views, Difference.of))
    pairs = [[render(some[frame], camera).rgb for some in (frames, others)] for frame, camera in views]
    errors = [plain_mse(*pair) for pair in pairs]
    assert [d.mse for d in found] == pytest.approx(errors, rel=1e-5)
    assert [d.ssim for d in found] == pytest.approx([plain_ssim(*pair) for pair in pairs], abs=1e-5)
    assert [d.delta_e for d in found] == pytest.approx([plain_delta_e(*pair) for pair in pairs], rel=1e-4)
    whole = pool(found)
    assert whole.psnr == pytest.approx(-10 * np.log10(sum(errors) / 5)) and whole.psnr < np.mean([*map(psnr, errors)])
    assert whole.worst == pytest.approx(min(-10 * np.log10(errors)))
    assert whole.ssim == pytest.approx(np.mean([d.ssim for d in found]))
    assert whole.delta_e == pytest.approx(np.mean([d.delta_e for d in found]))


@pytest.mark.parametrize(
    ("wanted", "shown", "mse", "colour"),
    [
        (constant(0.3), constant(0.3), 0.0, 0.0),
        (constant(0.0), constant(0.0), 0.0, 0.0),
        (constant(0.0), constant(1.0), 1.0, 100.0),  # black and white: L* of 0 and 100
        (constant(-3.0), constant(9.0), 1.0, 100.0),  # no screen shows less than black or more than white
        (constant(0.0, 1, 1), constant(0.0, 1, 1), 0.0, 0.0),
        (constant(0.25, 1, 1), constant(0.75, 1, 1), 0.25, None),
    ],
    ids=["equal", "all black", "black and white", "out of range", "one black pixel", "one pixel"],
)
def test_extreme_pictures(wanted, shown, mse, colour):
    (found,) = compare(files([wanted]), files([shown]), [(0, SIDE)], Difference.of)
    same = mse == 0
    assert found.mse == pytest.approx(mse, abs=0) and (found.ssim == pytest.approx(1, abs=1e-6)) == same
    assert found.delta_e == pytest.approx(plain_delta_e(wanted, shown) if colour is None else colour, abs=0.01)
    if wanted.size > 3:  # the window of the definition is mirrored, which takes two pixels
        assert found.ssim == pytest.approx(plain_ssim(wanted, shown), abs=1e-5)
    decibels = PSNR_CAP if same else pytest.approx(-10 * np.log10(mse))
    assert pool([found]) == Quality(decibels, decibels, found.ssim, found.delta_e)


def test_no_views_are_refused_before_anything_is_drawn():
    with pytest.raises(ConfigError, match="expected at least one"):
        compare(files([]), files([]), [], Picture.mse)


@pytest.mark.parametrize("other", [(1, 1), (12, 17), (16, 12)])
def test_pictures_of_different_sizes_are_refused(other):
    with pytest.raises(ConfigError, match=f"^frame 0, camera cam00: expected 16x12 pixels, got {other[1]}x{other[0]}$"):
        list(compare(files([constant(0.5)]), files([constant(0.5, *other)]), [(0, SIDE)], Picture.mse))


def test_sources_are_asked_when_a_view_is_due_and_few_pictures_are_held():
    asked, held = [], []

    def source(name):
        def show(frame, camera):
            asked.append((name, frame, camera))
            held.append(weakref.ref(picture := Picture.of(constant(frame / 8))))
            return picture

        return show

    views = [(4, SIDE), (1, WIDE), (4, SIDE)] * AHEAD
    found = compare(source("reference"), source("shown"), views, Picture.mse)
    assert asked == []
    for i, error in enumerate(found):
        due = views[: i + 1 + AHEAD]
        assert error == 0 and asked == [(name, *view) for view in due for name in ("reference", "shown")]
        assert sum(picture() is not None for picture in held) <= 2 * (AHEAD + 2)
    gc.collect()
    assert [picture() for picture in held] == [None] * len(asked)
    assert len(asked) == 2 * len(views)


def test_frames_are_read_once_for_all_views_that_follow_each_other():
    frames, read = moving_frames(30, 5), []
    source = draw_frames(lambda frame: read.append(frame) or frames[frame])
    views = [(frame, camera) for frame in (3, 1, 3) for camera in (SIDE, *OTHERS)]
    for frame, camera in views:
        assert np.array_equal(source(frame, camera).rgb, np.clip(render(frames[frame], camera).rgb, 0, 1))
    assert read == [3, 1, 3]


def test_frames_of_a_stream_are_taken_in_their_order():
    frames = moving_frames(30, 6)
    read = in_order([1, 2, 5], iter([frames[1], frames[2], frames[5]]))
    assert read(1) is frames[1] and read(5) is frames[5]
    with pytest.raises(ValueError, match="shorter"):
        in_order([1, 2], iter(frames[:1]))(2)


def test_what_stands_still_is_alike_in_every_frame():
    g = coloured_cloud(40)
    source, plain = draw_still(g), np.clip(render(g, WIDE).rgb, 0, 1)
    assert plain.any() and all(np.array_equal(source(frame, WIDE).rgb, plain) for frame in (0, 7))


def test_a_reference_is_drawn_once_for_all_that_is_compared_with_it():
    drawn = []

    def source(frame, camera):
        drawn.append((frame, camera))
        return Picture.of(constant(frame / 8))

    views = [(2, SIDE), (0, SIDE), (2, WIDE)]
    reference = draw_once(source)
    for error in (0.125, 0.5):
        shown = files([constant(frame / 8 + error) for frame in range(3)])
        assert list(compare(reference, shown, views[::-1], Picture.mse)) == pytest.approx([error**2] * 3)
    assert drawn == views[::-1]
