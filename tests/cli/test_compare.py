"""airgs-manifest compare as a user runs it."""

import json
import shutil

import pytest

from tests.faces import PSNR_CAP, airgs_manifest, read_picture
from tests.support.multiview_files import write_cameras
from tests.support.paths import FOX
from tests.support.scenes import moving_frames, write_sequence
from tests.support.views import ring


@pytest.fixture
def original(tmp_path):
    """The frames of the embedded scene without their cameras."""
    return shutil.copytree(FOX, tmp_path / "original", ignore=shutil.ignore_patterns("transforms.json"))


def figures(capsys, *arguments):
    capsys.readouterr()
    assert airgs_manifest(["compare", *map(str, arguments), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("rung", ["Q0+L0", "Q1+L2"])
def test_a_package_is_about_as_good_as_it_claims(original, demo_package, rung, capsys):
    report = figures(capsys, original, demo_package, "--rung", rung, "--every", "4")
    claimed, found = report["compared"]["claimed"], report["quality"]
    assert report["compared"]["rung"] == rung and report["reference"]["rung"] is None
    assert found["psnr"] == pytest.approx(claimed["psnr"], abs=1.0)
    assert found["ssim"] == pytest.approx(claimed["ssim"], abs=0.01)
    assert report["views"].startswith("8 views drawn from the viewing region")
    assert report["worst"]["psnr"] <= found["psnr"] and report["worst"]["camera"] in report["cameras"]
    assert report["compared"]["bytes_per_frame"] < report["reference"]["bytes_per_frame"]
    assert report["pictures"] == [] and report["left_out"] == []


def test_what_is_the_same_is_the_same(original, demo_package, capsys):
    for place in (original, demo_package):
        assert figures(capsys, place, place, "--frames", "1:2")["quality"]["psnr"] == PSNR_CAP


def test_of_two_packages_the_rung_is_that_of_the_second(demo_package, original, capsys):
    report = figures(capsys, demo_package, demo_package, "--rung", "Q1+L1", "--frames", "0")
    assert report["reference"]["rung"] == "Q0+L0" and report["compared"]["rung"] == "Q1+L1"
    report = figures(capsys, demo_package, original, "--rung", "Q1+L1", "--frames", "0")
    assert report["reference"]["rung"] == "Q1+L1" and report["compared"]["rung"] is None


def test_frames_and_views_are_chosen_and_pictures_written_and_named(original, demo_package, tmp_path, capsys):
    views, out = write_cameras(tmp_path / "views.json", ring(4, held_out=2)), tmp_path / "new" / "pictures"
    report = figures(capsys, original, demo_package, "--frames", "1:4", "--every", "2", "--views", views)
    assert report["frames"] == [1, 3] and report["views"] == f"2 held-out cameras of {views}"
    assert report["cameras"] == ["cam02", "cam03"] and report["worst"]["frame"] in (1, 3)
    assert airgs_manifest(["compare", str(original), str(demo_package), "--frames", "0:2", "-o", str(out)]) == 0
    words = capsys.readouterr().out
    assert f"pictures: {out / 'worst.png'}, {out / 'typical.png'}" in words and "A, the reference" in words
    assert sorted(path.name for path in out.iterdir()) == ["typical.png", "worst.png"]
    for path in out.iterdir():
        picture = read_picture(path)
        assert picture.shape[1] >= 3 * 320 and picture[:36].max() > 200 and picture[36:].any()


def test_both_are_seen_before_the_background_that_either_tells(tmp_path, capsys):
    """Whatever the views: on an orbit, of a file, or of a region; next to nothing of the scene is in a corner."""
    frames, told = moving_frames(400, 1), {"white": {"background": [1, 1, 1]}, "black": {}}
    white, black = (write_sequence(tmp_path / name, frames, cameras=False, **told[name]) for name in told)
    views = write_cameras(tmp_path / "views.json", ring(4, size=320))
    for places in ((white, black), (black, white)):
        for some in ([], ["--views", views]):
            figures(capsys, *places, *some, "-o", tmp_path / "out")
            picture = read_picture(tmp_path / "out" / "worst.png")
            wide = picture.shape[1] // 3
            assert min(picture[-1, x * wide].min() for x in (0, 1)) > 200


def test_frames_that_cannot_be_read_are_refused_and_nothing_is_written(original, tmp_path, capsys):
    broken = shutil.copytree(original, tmp_path / "broken")
    (broken / "000003.ply").write_bytes((broken / "000003.ply").read_bytes()[:-20])
    assert airgs_manifest(["compare", str(original), str(broken), "-o", str(tmp_path / "out")]) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1 and "000003.ply" in line and not (tmp_path / "out").exists()
