"""Decoded against original pictures: every rung of a package, and any two scenes or packages."""

import json
from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.inspect.compare import (
    LABEL,
    MOST_GAIN,
    compare_two,
    comparison_json,
    difference_gain,
    format_two,
    side_by_side,
)
from tests.faces import (
    PSNR_CAP,
    airgs_manifest,
    decode_frames,
    left_out,
    mse,
    open_package,
    open_side,
    psnr,
    render,
    to_bytes,
)
from tests.support.multiview_files import write_cameras
from tests.support.paths import VALID
from tests.support.scenes import moving_frames, random_gaussians, write_sequence
from tests.support.views import moved, ring

PACKAGE = VALID / "moving"


@pytest.fixture(scope="module")
def top(tmp_path_factory):
    """What the top rung of the package decodes to, as the original."""
    frames = [frame.gaussians for frame in decode_frames(open_package(PACKAGE), 0, 4)]
    return write_sequence(tmp_path_factory.mktemp("compare") / "top", frames, cameras=False)


@pytest.fixture
def original(tmp_path):
    return open_side(str(write_sequence(tmp_path / "original", moving_frames(40, 4))))


@pytest.fixture
def broken(tmp_path):
    """The same, but for some rows that are elsewhere in frame 2, a little in frame 1, and one row less in frame 3."""
    frames = moving_frames(40, 4)
    frames[1] = moved(frames[1], slice(0, 4), (0.05, 0.0, 0.0))
    frames[2] = moved(frames[2], slice(0, 12), (0.4, 0.2, 0.0))
    frames[3] = frames[3].take(slice(1, None))
    return open_side(str(write_sequence(tmp_path / "broken", frames)))


def figures(capsys, *arguments):
    draws = [] if "--draws" in arguments else ["--draws", "2"]
    assert airgs_manifest(["rungs", *map(str, arguments), *draws, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_every_rung_is_compared_and_the_one_that_was_the_original_is_exact(top, capsys):
    report = figures(capsys, PACKAGE, top)
    assert report["frames"] == [0, 1, 2, 3] and report["views"] == {"region": 2}
    decoded = report["quality"]["region"]
    assert list(decoded) == ["Q0+L0", "Q0+L1", "Q1+L0", "Q1+L1"] == list(report["quality"]["claimed"])
    exact = {"ssim": pytest.approx(1), "delta_e": pytest.approx(0, abs=1e-4)}
    assert decoded["Q0+L0"] == {"psnr": PSNR_CAP, "worst": PSNR_CAP} | exact
    for name in ("Q0+L1", "Q1+L0", "Q1+L1"):
        assert decoded[name]["worst"] < decoded[name]["psnr"] < 60
        assert decoded[name]["ssim"] < 1 and decoded[name]["delta_e"] > 0


def test_cameras_and_draws_are_splits_of_their_own(top, tmp_path, capsys):
    """Other draws are other pictures; what one split measures does not depend on the others."""
    views = write_cameras(tmp_path / "views.json", ring(4, held_out=1))
    rung = [PACKAGE, top, "--views", views, "--every", "3", "--level", "L1"]
    report = figures(capsys, *rung)
    assert report["views"] == {"test": 1, "region": 2}
    alone = figures(capsys, *rung, "--split", "test")
    assert alone["views"] == {"test": 1} and alone["quality"]["test"] == report["quality"]["test"]
    assert figures(capsys, *rung, "--split", "train")["views"] == {"train": 3}
    others = figures(capsys, *rung, "--seed", "5", "--split", "region")["quality"]["region"]
    assert others != report["quality"]["region"]
    assert figures(capsys, *rung, "--draws", "0")["views"] == {"test": 1}
    assert airgs_manifest(["rungs", *map(str, rung), "--draws", "1"]) == 0
    out = capsys.readouterr().out
    assert "claimed: dB" in out and "region: dB" in out and "test: dB" in out and "train" not in out


def test_one_rung_of_some_frames_is_that_of_all_rungs(top, capsys):
    part = [PACKAGE, top, "--frames", "1:4", "--every", "2"]
    every = figures(capsys, *part)
    one = figures(capsys, *part, "--level", "L1", "--key-quality", "1")
    assert every["frames"] == one["frames"] == [1, 3]
    assert one["quality"]["region"] == {"Q1+L1": every["quality"]["region"]["Q1+L1"]}


@pytest.mark.parametrize(
    "options",
    [
        ["--level", "L9"],
        ["--key-quality", "Q9"],
        ["--frames", "9"],
        ["--every", "0"],
        ["--split", "none"],
        ["--draws", "-1"],
    ],
)
def test_what_is_not_there_is_refused_in_one_line(top, options, capsys):
    assert airgs_manifest(["rungs", str(PACKAGE), str(top), *options]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_sequences_of_other_lengths_and_what_is_no_package_are_refused(top, tmp_path, capsys):
    short = write_sequence(tmp_path / "short", moving_frames(20, 2))
    for arguments in ([PACKAGE, short], [short, top]):
        assert airgs_manifest(["rungs", *map(str, arguments)]) == 2
        assert capsys.readouterr().err.count("\n") == 1


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


def test_other_degrees_and_lengths_are_compared_and_said(original, tmp_path):
    long = open_side(str(write_sequence(tmp_path / "long", moving_frames(60, 6, degree=2))))
    result = compare_two(original, long, range(4), ring(1))
    words = format_two(original, long, result, "1 view", left_out(original, long))
    assert "A, the reference: " in words and "SH degree 2" in words and "left out: frames 4 to 5" in words


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
    other = open_side(str(write_sequence(tmp_path / "nan", [replace(g, means=means)])))
    result = compare_two(original, other, range(1), ring(1))
    assert result.gaussians[1] == (40, 40) and np.isfinite(result.quality.psnr)
    assert comparison_json(original, other, result)["compared"]["gaussians"] == [40, 40]
