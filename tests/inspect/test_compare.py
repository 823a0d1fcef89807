"""Decoded against original pictures: every rung of a package, and any two scenes or packages as two sides."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from tests import faces
from tests.faces import LABEL, PSNR_CAP, ConfigError, airgs_manifest, comparable, compare_two, left_out, open_side
from tests.support.multiview_files import write_cameras
from tests.support.paths import FOX, VALID
from tests.support.scenes import moving_frames, random_gaussians, write_sequence
from tests.support.views import moved, ring

PACKAGE = VALID / "moving"


@pytest.fixture(scope="module")
def top(tmp_path_factory):
    """What the top rung of the package decodes to, as the original."""
    frames = [frame.gaussians for frame in faces.decode_frames(faces.open_package(PACKAGE), 0, 4)]
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


@pytest.fixture
def fox(tmp_path):
    """The frames of the embedded scene without their cameras."""
    return shutil.copytree(FOX, tmp_path / "fox", ignore=shutil.ignore_patterns("transforms.json"))


@pytest.fixture
def figures(capsys):
    """A function of the words of a command to what it says as JSON."""

    def say(command, *words):
        draws = ["--draws", "2"] if command == "rungs" and "--draws" not in words else []
        assert airgs_manifest([command, *map(str, words), *draws, "--json"]) == 0
        return json.loads(capsys.readouterr().out)

    return say


def test_every_rung_is_compared_and_the_one_that_was_the_original_is_exact(top, figures):
    report = figures("rungs", PACKAGE, top)
    assert report["frames"] == [0, 1, 2, 3] and report["views"] == 2
    decoded, rungs = {row["rung"]: row for row in report["rungs"]}, faces.open_package(PACKAGE).rungs
    assert [(name, row["claimed"]) for name, row in decoded.items()] == [(rung.name, rung.psnr) for rung in rungs]
    top_row = decoded["Q0+L0"]
    assert top_row["psnr"] == top_row["low"] == PSNR_CAP
    assert top_row["ssim"] == pytest.approx(1) and top_row["delta_e"] == pytest.approx(0, abs=1e-4)
    for name in ("Q0+L1", "Q1+L0", "Q1+L1"):
        assert decoded[name]["low"] < decoded[name]["psnr"] < 60
        assert decoded[name]["ssim"] < 1 and decoded[name]["delta_e"] > 0


def test_rungs_are_seen_from_held_out_cameras_that_are_given(top, tmp_path, capsys, figures):
    views = write_cameras(tmp_path / "views.json", ring(4, held_out=1))
    rung = [PACKAGE, top, "--views", views, "--every", "3"]
    assert figures("rungs", *rung)["views"] == 1
    assert airgs_manifest(["rungs", *map(str, rung)]) == 0
    out = capsys.readouterr().out
    assert "2 frames in 1 views" in out and "claimed dB" in out and "Q1+L1" in out


@pytest.mark.parametrize("rung", ["Q0+L0", "Q1+L2"])
def test_a_package_is_about_as_good_as_it_claims(fox, demo_package, rung, figures):
    report = figures("compare", fox, demo_package, "--rung", rung, "--every", "4")
    claimed, found = report["compared"]["claimed"], report["quality"]
    assert report["compared"]["rung"] == rung and report["reference"]["rung"] is None
    assert found["psnr"] == pytest.approx(claimed["psnr"], abs=1.0)
    assert found["ssim"] == pytest.approx(claimed["ssim"], abs=0.01)
    assert report["views"].startswith("8 views drawn from the viewing region")
    assert report["lowest"]["psnr"] <= found["psnr"] and report["lowest"]["camera"] in report["cameras"]
    assert report["compared"]["bytes_per_frame"] < report["reference"]["bytes_per_frame"]
    assert report["pictures"] == [] and report["left_out"] == []


def test_what_is_the_same_is_the_same_and_of_two_packages_the_rung_is_that_of_the_second(fox, demo_package, figures):
    for place in (fox, demo_package):
        assert figures("compare", place, place, "--frames", "1:2")["quality"]["psnr"] == PSNR_CAP
    for second, rungs in ((demo_package, ("Q0+L0", "Q1+L1")), (fox, ("Q1+L1", None))):
        report = figures("compare", demo_package, second, "--rung", "Q1+L1", "--frames", "0")
        assert (report["reference"]["rung"], report["compared"]["rung"]) == rungs


def test_frames_and_views_are_chosen_and_pictures_written_and_named(fox, demo_package, tmp_path, figures, capsys):
    views, out = write_cameras(tmp_path / "views.json", ring(4, held_out=2)), tmp_path / "new" / "pictures"
    report = figures("compare", fox, demo_package, "--frames", "1:4", "--every", "2", "--views", views)
    assert report["frames"] == [1, 3] and report["views"] == f"2 held-out cameras of {views}"
    assert report["cameras"] == ["cam02", "cam03"] and report["lowest"]["frame"] in (1, 3)
    assert airgs_manifest(["compare", str(fox), str(demo_package), "--frames", "0:2", "-o", str(out)]) == 0
    words = capsys.readouterr().out
    assert f"pictures: {out / 'lowest.png'}\n" in words and "A, the reference" in words
    picture = faces.read_picture(out / "lowest.png")
    assert picture.shape[1] >= 3 * 320 and picture[:36].max() > 200 and picture[36:].any()


def test_both_are_seen_before_the_background_that_either_tells(tmp_path, figures):
    """Whatever the views: on an orbit, of a file, or of a region; next to nothing of the scene is in a corner."""
    frames, told = moving_frames(400, 1), {"white": {"background": [1, 1, 1]}, "black": {}}
    white, black = (write_sequence(tmp_path / name, frames, cameras=False, **told[name]) for name in told)
    views = write_cameras(tmp_path / "views.json", ring(4, size=320))
    for places in ((white, black), (black, white)):
        for some in ([], ["--views", views]):
            figures("compare", *places, *some, "-o", tmp_path / "out")
            picture = faces.read_picture(tmp_path / "out" / "lowest.png")
            wide = picture.shape[1] // 3
            assert min(picture[-1, x * wide].min() for x in (0, 1)) > 200


def test_the_lowest_picture_is_the_lowest(original, broken):
    cameras, frames = ring(5), range(1, 4)
    result = compare_two(original, broken, frames, cameras)
    errors = {}
    for number, first, second in zip(frames, original.read(frames), broken.read(frames), strict=True):
        for camera in cameras:
            errors[number, camera.name] = faces.mse(faces.render(second, camera).rgb, faces.render(first, camera).rgb)
    ranked = sorted(errors, key=errors.__getitem__)
    assert (result.lowest.frame, result.lowest.camera.name) == ranked[-1] and result.lowest.frame == 2
    assert result.lowest.psnr == pytest.approx(faces.psnr(errors[ranked[-1]]))
    assert result.quality.psnr == pytest.approx(faces.psnr(float(np.mean(list(errors.values())))))
    low = np.quantile([faces.psnr(error) for error in errors.values()], 0.05)
    assert f"worst   {low:.2f} dB" in faces.format_two(faces.comparison_json(original, broken, result), "5 views")
    assert result.gaussians == ((40, 40), (39, 40))


def test_other_degrees_and_lengths_are_compared_and_what_one_side_lacks_is_said(original, tmp_path):
    long, one_more = scene(tmp_path / "6", moving_frames(60, 6, degree=2)), scene(tmp_path / "5", moving_frames(40, 5))
    lacking = [f"frames 4 to 5 of {long.name}, which {original.name} does not have"]
    assert left_out(original, long) == left_out(long, original) == lacking
    assert left_out(original, one_more)[0].startswith("frame 4 of") and left_out(original, original) == []
    result = compare_two(original, long, range(4), ring(1))
    words = faces.format_two(faces.comparison_json(original, long, result), "1 view", lacking)
    assert "A, the reference" in words and "SH degree" in words and "left out: frames 4 to 5" in words


def test_pictures_show_both_and_their_difference(original, broken):
    seen = compare_two(original, broken, range(4), ring(2, size=400)).lowest
    picture = faces.side_by_side(original, broken, seen)
    assert picture.shape == (LABEL + 400, 3 * 400, 3)
    first, second, difference = (picture[LABEL:, 400 * i : 400 * (i + 1)] for i in range(3))
    shown = [faces.to_bytes(faces.render(next(s.read(range(2, 3))), seen.camera).rgb) for s in (original, broken)]
    assert np.array_equal(first, shown[0]) and np.array_equal(second, shown[1])
    apart = np.abs(shown[0].astype(int) - shown[1])
    assert (difference[apart > 20] > 15).all() and not difference[(apart == 0).all(axis=2)].max() > 32
    labels = [picture[top : top + 18, 400 * i : 400 * (i + 1)] for i in range(3) for top in (0, 18)]
    assert all(label.max() > 200 for label in labels)


def test_small_pictures_have_room_for_labels_and_differences_are_amplified_until_they_are_seen(original):
    seen = compare_two(original, original, range(1), ring(1, size=48)).lowest
    picture = faces.side_by_side(replace(original, name="x" * 300), original, seen)
    assert picture.shape == (LABEL + 7 * 48, 3 * 7 * 48, 3)
    assert not picture[LABEL:, 2 * 7 * 48 :].any(), "equal pictures have no difference"
    for largest, gain in ((1.0, 1), (0.5, 2), (0.3, 2), (0.1, 8), (1e-5, 64), (0.0, 64)):
        assert faces.difference_gain(np.full((20, 20, 3), largest, np.float32)) == gain


def test_broken_rows_are_repaired_on_both_sides(original, tmp_path):
    other = scene(tmp_path / "nan", [moved(random_gaussians(40), slice(3, 4), (np.nan, np.nan, np.nan))])
    result = compare_two(original, other, range(1), ring(1))
    assert result.gaussians[1] == (40, 40) and np.isfinite(result.quality.psnr)
    assert faces.comparison_json(original, other, result)["compared"]["gaussians"] == [40, 40]


def test_a_rung_has_its_bytes_its_claim_and_its_gaussians_and_a_scene_the_bytes_of_its_files(original, tmp_path):
    package = faces.open_package(PACKAGE)
    rungs = {rung.name: rung for rung in package.rungs}
    for name in ("Q0+L0", "Q1+L1"):
        side = open_side(str(PACKAGE), name)
        assert (side.rung, side.bytes_per_frame) == (name, rungs[name].bytes / package.manifest.frames)
        assert side.claimed.psnr == rungs[name].psnr
        decoded = faces.decode_frames(package, 2, 3, keyframe_quality=name[:2], level=name[3:])
        assert np.array_equal(next(side.read(range(2, 3))).means, next(decoded).gaussians.means, equal_nan=True)
    assert open_side(str(PACKAGE)).rung == "Q0+L0" and open_side(str(PACKAGE)).label == "moving Q0+L0"
    for rung in ("Q9+L0", "Q0+L9", "Q0", "L0", "+"):
        with pytest.raises(ConfigError, match="expected one of"):
            open_side(str(PACKAGE), rung)
    sizes = [path.stat().st_size for path in (tmp_path / "original").glob("*.ply")]
    assert original.bytes_per_frame == np.mean(sizes) and original.claimed is None and original.label == "original"
    with pytest.raises(ConfigError, match="expected a package for the rung Q0"):
        open_side(original.name, "Q0+L0")


def test_rates_that_are_stated_must_agree(tmp_path):
    frames = moving_frames(10, 2)
    slow, fast = (scene(tmp_path / f"at{fps}", frames, fps=fps) for fps in (24, 30))
    with pytest.raises(ConfigError, match=r"at30: expected 24 frames a second as .*at24, got 30"):
        comparable(slow, fast)
    comparable(slow, scene(tmp_path / "silent", frames))
    comparable(slow, scene(tmp_path / "single", frames[:1], fps=30))


def test_views_are_those_of_the_scenes_or_of_the_region_or_an_orbit(original, tmp_path):
    package = open_side(str(PACKAGE))
    words, views = faces.shared_views(original, package)
    assert f"8 views drawn from the viewing region of {PACKAGE}, seed 2" == words
    drawn = faces.draw_views(package.region, 8, 2)
    assert all(np.array_equal(a.world_to_camera, b.world_to_camera) for a, b in zip(views, drawn, strict=True))
    words, views = faces.shared_views(original, original)
    assert "orbit around frame 0" in words and len(views) == 8
    write_cameras(tmp_path / "original" / "transforms.json", ring(4, held_out=1))
    words, views = faces.shared_views(package, open_side(original.name))
    assert words == f"1 held-out camera of {original.name}" and [v.split for v in views] == ["test"]


def test_held_out_cameras_are_taken_where_there_are_any():
    for cameras, taken in ((ring(4, held_out=1), ["test"]), (ring(4), ["train"] * 4)):
        assert [camera.split for camera in faces.compared_views(cameras)] == taken
