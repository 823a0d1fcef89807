"""Two scenes or packages beside each other: figures, the worst picture, views that both are seen from, pictures."""

from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.decoder.decode import decode_frames
from airgs_codec.errors import ConfigError
from airgs_codec.inspect.side_by_side import LABEL, MOST_GAIN, difference_gain, side_by_side
from airgs_codec.inspect.sides import DRAWS, expect_same_rate, left_out, open_side, shared_views
from airgs_codec.inspect.summary import summarise
from airgs_codec.inspect.two import compare_two, comparison_json, format_two
from airgs_codec.media.image import to_bytes
from airgs_codec.media.metrics import PSNR_CAP, mse, psnr
from airgs_codec.package.region import CHECKING, draw_views
from airgs_codec.package.store import open_package
from airgs_codec.render import render
from tests.support.multiview_files import write_cameras
from tests.support.paths import VALID
from tests.support.scenes import moving_frames, random_gaussians, write_sequence
from tests.support.views import moved, ring

PACKAGE = VALID / "moving"


def scene(folder, frames, **settings):
    return open_side(str(write_sequence(folder, frames, **settings)))


@pytest.fixture
def original(tmp_path):
    return scene(tmp_path / "original", moving_frames(40, 4))


@pytest.fixture
def broken(tmp_path):
    """The same, but for some rows that are elsewhere in frame 2, a little in frame 1, and one row less in frame 3."""
    frames = moving_frames(40, 4)
    frames[1] = moved(frames[1], slice(0, 4), (0.05, 0.0, 0.0))
    frames[2] = moved(frames[2], slice(0, 12), (0.4, 0.2, 0.0))
    frames[3] = frames[3].take(slice(1, None))
    return scene(tmp_path / "broken", frames)


def test_a_scene_is_like_itself(original):
    result = compare_two(original, original, range(4), ring(3))
    assert result.quality.psnr == result.worst.psnr == result.typical.psnr == PSNR_CAP
    assert result.quality.ssim == pytest.approx(1) and result.quality.delta_e == pytest.approx(0, abs=1e-4)
    assert result.frames == (0, 1, 2, 3) and result.gaussians == ((40, 40), (40, 40))


def test_the_worst_picture_is_the_worst_and_the_typical_one_the_median(original, broken):
    cameras, frames = ring(5), range(1, 4)
    result = compare_two(original, broken, frames, cameras)
    errors = {}
    for number, first, second in zip(frames, original.read(frames), broken.read(frames), strict=True):
        for camera in cameras:
            errors[number, camera.name] = mse(render(second, camera).rgb, render(first, camera).rgb)
    ranked = sorted(errors, key=errors.__getitem__)
    assert (result.worst.frame, result.worst.camera.name) == ranked[-1] and result.worst.frame == 2
    assert result.worst.psnr == pytest.approx(psnr(errors[ranked[-1]]))
    assert (result.typical.frame, result.typical.camera.name) == ranked[len(ranked) // 2]
    assert result.quality.psnr == pytest.approx(psnr(float(np.mean(list(errors.values())))))
    assert result.gaussians == ((40, 40), (39, 40))


def test_every_second_frame_is_every_second_frame_of_both(original):
    package = open_side(str(PACKAGE), "Q1+L1")
    result = compare_two(package, original, range(1, 4, 2), ring(1))
    assert result.frames == (1, 3)
    assert result.quality.psnr < 60


def test_a_rung_has_its_bytes_its_claim_and_its_gaussians():
    package = open_package(PACKAGE)
    rungs = {f"{r.key}+{r.state}": r for r in summarise(package.manifest, package.manifest_bytes).rungs}
    for name in ("Q0+L0", "Q1+L1"):
        side = open_side(str(PACKAGE), name)
        assert side.rung == name and side.bytes_per_frame == rungs[name].bytes_per_frame
        assert side.claimed.psnr == rungs[name].psnr
        decoded = decode_frames(package, 2, 3, key_quality=name[:2], level=name[3:])
        assert np.array_equal(next(side.read(range(2, 3))).means, next(decoded).gaussians.means, equal_nan=True)
    assert open_side(str(PACKAGE)).rung == "Q0+L0" and open_side(str(PACKAGE)).label == "moving Q0+L0"
    for rung in ("Q9+L0", "Q0+L9", "Q0", "L0", ""):
        with pytest.raises(ConfigError, match="expected one of"):
            open_side(str(PACKAGE), rung or "+")


def test_a_scene_has_the_bytes_of_its_files_and_no_rungs(original, tmp_path):
    sizes = [path.stat().st_size for path in (tmp_path / "original").glob("*.ply")]
    assert original.bytes_per_frame == np.mean(sizes) and original.claimed is None and original.label == "original"
    with pytest.raises(ConfigError, match="expected a package for the rung Q0"):
        open_side(original.name, "Q0+L0")


def test_other_degrees_and_lengths_are_compared_and_said(original, tmp_path):
    long = scene(tmp_path / "long", moving_frames(60, 6, degree=2))
    assert left_out(original, long) == left_out(long, original)
    assert left_out(original, long) == [f"frames 4 to 5 of {long.name}, which {original.name} does not have"]
    one_more = scene(tmp_path / "five", moving_frames(40, 5))
    assert left_out(original, one_more)[0].startswith("frame 4 of") and left_out(original, original) == []
    result = compare_two(original, long, range(4), ring(1))
    words = format_two(original, long, result, "1 view", left_out(original, long))
    assert "A, the reference: " in words and "SH degree 2" in words and "left out: frames 4 to 5" in words


def test_rates_that_are_stated_must_agree(tmp_path):
    frames = moving_frames(10, 2)
    slow, fast = (scene(tmp_path / f"at{fps}", frames, fps=fps) for fps in (24, 30))
    with pytest.raises(ConfigError, match=r"at30: expected 24 frames a second as .*at24, got 30"):
        expect_same_rate(slow, fast)
    expect_same_rate(slow, scene(tmp_path / "silent", frames))
    expect_same_rate(slow, scene(tmp_path / "single", frames[:1], fps=30))


def test_views_are_those_of_the_scenes_or_of_the_region_or_an_orbit(original, tmp_path):
    package = open_side(str(PACKAGE))
    words, views = shared_views(original, package)
    assert f"{DRAWS} views drawn from the viewing region of {PACKAGE}, seed 2" == words
    drawn = draw_views(package.region, DRAWS, CHECKING)
    assert all(np.array_equal(a.world_to_camera, b.world_to_camera) for a, b in zip(views, drawn, strict=True))
    words, views = shared_views(original, original)
    assert "orbit around frame 0" in words and len(views) == 8
    write_cameras(tmp_path / "original" / "transforms.json", ring(4, held_out=1))
    words, views = shared_views(package, open_side(original.name))
    assert words == f"1 held-out camera of {original.name}" and [v.split for v in views] == ["test"]


def test_pictures_show_both_and_their_difference(original, broken):
    seen = compare_two(original, broken, range(4), ring(2, size=400)).worst
    picture = side_by_side(original, broken, seen)
    assert picture.shape == (LABEL + 400, 3 * 400, 3)
    first, second, difference = (picture[LABEL:, 400 * i : 400 * (i + 1)] for i in range(3))
    shown = [to_bytes(render(next(s.read(range(2, 3))), seen.camera).rgb) for s in (original, broken)]
    assert np.array_equal(first, shown[0]) and np.array_equal(second, shown[1])
    apart = np.abs(shown[0].astype(int) - shown[1])
    assert (difference[apart > 20] > 15).all() and not difference[(apart == 0).all(axis=2)].max() > 32
    labels = [picture[top : top + 18, 400 * i : 400 * (i + 1)] for i in range(3) for top in (0, 18)]
    assert all(label.max() > 200 for label in labels)


def test_small_pictures_have_room_for_labels(original):
    seen = compare_two(original, original, range(1), ring(1, size=48)).worst
    picture = side_by_side(replace(original, name="x" * 300), original, seen)
    assert picture.shape == (LABEL + 7 * 48, 3 * 7 * 48, 3)
    assert not picture[LABEL:, 2 * 7 * 48 :].any(), "equal pictures have no difference"


def test_differences_are_amplified_until_they_are_seen():
    for largest, gain in ((1.0, 1), (0.5, 2), (0.3, 2), (0.1, 8), (1e-5, MOST_GAIN), (0.0, MOST_GAIN)):
        assert difference_gain(np.full((20, 20, 3), largest, np.float32)) == gain


def test_broken_rows_are_repaired_on_both_sides(original, tmp_path):
    g = random_gaussians(40)
    means = g.means.copy()
    means[3] = np.nan
    other = scene(tmp_path / "nan", [replace(g, means=means)])
    result = compare_two(original, other, range(1), ring(1))
    assert result.gaussians[1] == (39, 39) and np.isfinite(result.quality.psnr)
    assert comparison_json(original, other, result)["compared"]["gaussians"] == [39, 39]
