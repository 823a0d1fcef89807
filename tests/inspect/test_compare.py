"""Decoded against original pictures: every rung of a package, and any two scenes or packages as two sides."""

import json
from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.inspect.compare import (
    LABEL,
    compare_two,
    comparison_json,
    difference_gain,
    format_two,
    side_by_side,
)
from airgs_codec.inspect.sides import comparable, compared_views, region_views, shared_views
from tests import faces
from tests.faces import ConfigError, airgs_manifest, decode_frames, left_out, open_package, open_side
from tests.support.multiview_files import write_cameras
from tests.support.paths import VALID
from tests.support.regions import arc
from tests.support.scenes import moving_frames, random_gaussians, write_sequence
from tests.support.views import moved, ring

PACKAGE = VALID / "moving"


@pytest.fixture(scope="module")
def top(tmp_path_factory):
    """What the top rung of the package decodes to, as the original."""
    frames = [frame.gaussians for frame in decode_frames(open_package(PACKAGE), 0, 4)]
    return write_sequence(tmp_path_factory.mktemp("compare") / "top", frames, cameras=False)


def scene(folder, frames, **settings):
    return open_side(str(write_sequence(folder, frames, cameras=False, **settings)))


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
    assert decoded["Q0+L0"] == {"psnr": faces.PSNR_CAP, "worst": faces.PSNR_CAP} | exact
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


def test_the_worst_picture_is_the_worst_and_the_typical_one_the_median(original, broken):
    cameras, frames = ring(5), range(1, 4)
    result = compare_two(original, broken, frames, cameras)
    errors = {}
    for number, first, second in zip(frames, original.read(frames), broken.read(frames), strict=True):
        for camera in cameras:
            errors[number, camera.name] = faces.mse(faces.render(second, camera).rgb, faces.render(first, camera).rgb)
    ranked = sorted(errors, key=errors.__getitem__)
    assert (result.worst.frame, result.worst.camera.name) == ranked[-1] and result.worst.frame == 2
    assert result.worst.psnr == pytest.approx(faces.psnr(errors[ranked[-1]]))
    assert (result.typical.frame, result.typical.camera.name) == ranked[len(ranked) // 2]
    assert result.quality.psnr == pytest.approx(faces.psnr(float(np.mean(list(errors.values())))))
    assert result.gaussians == ((40, 40), (39, 40))


def test_other_degrees_and_lengths_are_compared_and_said(original, tmp_path):
    long = scene(tmp_path / "long", moving_frames(60, 6, degree=2))
    result = compare_two(original, long, range(4), ring(1))
    words = format_two(original, long, result, "1 view", left_out(original, long))
    assert "A, the reference: " in words and "SH degree 2" in words and "left out: frames 4 to 5" in words


def test_pictures_show_both_and_their_difference(original, broken):
    seen = compare_two(original, broken, range(4), ring(2, size=400)).worst
    picture = side_by_side(original, broken, seen)
    assert picture.shape == (LABEL + 400, 3 * 400, 3)
    first, second, difference = (picture[LABEL:, 400 * i : 400 * (i + 1)] for i in range(3))
    shown = [faces.to_bytes(faces.render(next(s.read(range(2, 3))), seen.camera).rgb) for s in (original, broken)]
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
    for largest, gain in ((1.0, 1), (0.5, 2), (0.3, 2), (0.1, 8), (1e-5, 64), (0.0, 64)):
        assert difference_gain(np.full((20, 20, 3), largest, np.float32)) == gain


def test_broken_rows_are_repaired_on_both_sides(original, tmp_path):
    g = random_gaussians(40)
    means = g.means.copy()
    means[3] = np.nan
    other = scene(tmp_path / "nan", [replace(g, means=means)])
    result = compare_two(original, other, range(1), ring(1))
    assert result.gaussians[1] == (40, 40) and np.isfinite(result.quality.psnr)
    assert comparison_json(original, other, result)["compared"]["gaussians"] == [40, 40]


def test_a_rung_has_its_bytes_its_claim_and_its_gaussians():
    package = open_package(PACKAGE)
    rungs = {f"{r.key}+{r.state}": r for r in faces.summarise(package.manifest, package.manifest_bytes).rungs}
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


def test_frames_that_one_side_lacks_are_named(original, tmp_path):
    long, one_more = (scene(tmp_path / f"{n}", moving_frames(40, n)) for n in (6, 5))
    assert left_out(original, long) == left_out(long, original)
    assert left_out(original, long) == [f"frames 4 to 5 of {long.name}, which {original.name} does not have"]
    assert left_out(original, one_more)[0].startswith("frame 4 of") and left_out(original, original) == []


def test_rates_that_are_stated_must_agree(tmp_path):
    frames = moving_frames(10, 2)
    slow, fast = (scene(tmp_path / f"at{fps}", frames, fps=fps) for fps in (24, 30))
    with pytest.raises(ConfigError, match=r"at30: expected 24 frames a second as .*at24, got 30"):
        comparable(slow, fast)
    comparable(slow, scene(tmp_path / "silent", frames))
    comparable(slow, scene(tmp_path / "single", frames[:1], fps=30))


def test_views_are_those_of_the_scenes_or_of_the_region_or_an_orbit(original, tmp_path):
    package = open_side(str(PACKAGE))
    words, views = shared_views(original, package)
    assert f"8 views drawn from the viewing region of {PACKAGE}, seed 2" == words
    drawn = faces.draw_views(package.region, 8, 2)
    assert all(np.array_equal(a.world_to_camera, b.world_to_camera) for a, b in zip(views, drawn, strict=True))
    words, views = shared_views(original, original)
    assert "orbit around frame 0" in words and len(views) == 8
    write_cameras(tmp_path / "original" / "transforms.json", ring(4, held_out=1))
    words, views = shared_views(package, open_side(original.name))
    assert words == f"1 held-out camera of {original.name}" and [v.split for v in views] == ["test"]


def test_held_out_cameras_are_taken_where_there_are_any():
    assert [c.split for c in compared_views(ring(4, held_out=1), None)] == ["test"]
    assert len(compared_views(ring(4), None)) == 4
    drawn = region_views(arc(90, 3, 1.0), 5, 2)
    assert [c.split for c in compared_views([*ring(4, held_out=1), *drawn], None)] == ["test"] + ["region"] * 5
    assert len(compared_views([*ring(4), *drawn], None)) == 9
    assert len(compared_views(ring(4, held_out=1), "train")) == 3
    with pytest.raises(ConfigError, match="split: expected one of train"):
        compared_views(ring(4), "test")
