"""airgs-manifest compare as a user runs it."""

import json

import pytest

from tests.faces import PSNR_CAP, airgs_encode, airgs_manifest, read_picture
from tests.support.multiview_files import write_cameras
from tests.support.scenes import moving_frames, write_sequence
from tests.support.views import ring


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    return write_sequence(tmp_path_factory.mktemp("compare") / "scene", moving_frames(400, 4), cameras=False, fps=10)


@pytest.fixture(scope="module")
def package(original):
    out = original.parent / "scene.airgs"
    views = write_cameras(original.parent / "views.json", ring(8, size=128))
    options = ["--x264-preset", "veryfast", "--calibrate", "none", "--measure-pictures", "8", "--views", str(views)]
    assert airgs_encode([str(original), "-o", str(out), *options, "--json"]) == 0
    return out


def figures(capsys, *arguments):
    capsys.readouterr()
    assert airgs_manifest(["compare", *map(str, arguments), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_a_package_is_about_as_good_as_it_claims(original, package, capsys):
    for rung in ("Q0+L0", "Q1+L1"):
        report = figures(capsys, original, package, "--rung", rung)
        claimed, found = report["compared"]["claimed"], report["quality"]
        assert report["compared"]["rung"] == rung and report["reference"]["rung"] is None
        assert found["psnr"] == pytest.approx(claimed["psnr"], abs=1.0)
        assert found["ssim"] == pytest.approx(claimed["ssim"], abs=0.01)
        assert report["views"].startswith("8 views drawn from the viewing region")
        assert report["worst"]["psnr"] <= found["psnr"] and report["worst"]["camera"] in report["cameras"]
        assert report["compared"]["bytes_per_frame"] < report["reference"]["bytes_per_frame"]
    assert report["pictures"] == [] and report["left_out"] == []


def test_what_is_the_same_is_the_same(original, package, capsys):
    for place in (original, package):
        assert figures(capsys, place, place, "--frames", "1:2")["quality"]["psnr"] == PSNR_CAP


def test_of_two_packages_the_rung_is_that_of_the_second(package, original, capsys):
    report = figures(capsys, package, package, "--rung", "Q1+L1", "--frames", "0")
    assert report["reference"]["rung"] == "Q0+L0" and report["compared"]["rung"] == "Q1+L1"
    report = figures(capsys, package, original, "--rung", "Q1+L1", "--frames", "0")
    assert report["reference"]["rung"] == "Q1+L1" and report["compared"]["rung"] is None


def test_frames_and_views_are_chosen(original, package, tmp_path, capsys):
    views = write_cameras(tmp_path / "views.json", ring(4, held_out=2))
    report = figures(capsys, original, package, "--frames", "1:4", "--every", "2", "--views", views)
    assert report["frames"] == [1, 3] and report["views"] == f"2 held-out cameras of {views}"
    assert report["cameras"] == ["cam02", "cam03"] and report["worst"]["frame"] in (1, 3)


def test_both_are_seen_before_the_background_that_either_tells(original, tmp_path, capsys):
    """Whatever the views: on an orbit, of a file, or of a region; next to nothing of the scene is in a corner."""
    frames = moving_frames(400, 4)
    white = write_sequence(tmp_path / "white", frames[:1], fps=10, background=[1, 1, 1])
    views = write_cameras(tmp_path / "views.json", ring(4, size=320))
    for places in ((white, original), (original, white)):
        for some in ([], ["--views", views]):
            figures(capsys, *places, *some, "-o", tmp_path / "out")
            picture = read_picture(tmp_path / "out" / "worst.png")
            wide = picture.shape[1] // 3
            assert min(picture[-1, x * wide].min() for x in (0, 1)) > 200


def test_pictures_are_written_and_named(original, package, tmp_path, capsys):
    out = tmp_path / "new" / "pictures"
    assert airgs_manifest(["compare", str(original), str(package), "--frames", "0:2", "-o", str(out)]) == 0
    words = capsys.readouterr().out
    assert f"pictures: {out / 'worst.png'}, {out / 'typical.png'}" in words and "A, the reference" in words
    assert sorted(path.name for path in out.iterdir()) == ["typical.png", "worst.png"]
    for path in out.iterdir():
        picture = read_picture(path)
        assert picture.shape[1] >= 3 * 320 and picture[:36].max() > 200 and picture[36:].any()


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (["--frames", "9"], "--frames"),
        (["--frames", "x"], "--frames"),
        (["--every", "0"], "--every"),
        (["--rung", "Q9+L0"], "key_quality"),
        (["--rung", "Q0"], "level"),
        (["--views", "nowhere.json"], "nowhere.json"),
    ],
)
def test_what_cannot_be_compared_is_refused_and_nothing_written(original, package, tmp_path, capsys, options, word):
    out = tmp_path / "out"
    assert airgs_manifest(["compare", str(original), str(package), "-o", str(out), *options]) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1 and word in line and not out.exists()


def test_other_places_are_refused(original, package, tmp_path, capsys):
    faster = write_sequence(tmp_path / "faster", moving_frames(40, 4), fps=20)
    broken = write_sequence(tmp_path / "broken", moving_frames(40, 4), fps=10)
    (broken / "000003.ply").write_bytes((broken / "000003.ply").read_bytes()[:-20])
    file, out = tmp_path / "file", tmp_path / "out"
    file.write_text("a file")
    cases = [
        ([original, tmp_path / "nowhere"], "nowhere"),
        ([original, faster], "expected 10 frames a second"),
        ([original, broken], "000003.ply"),
        ([original, "ftp://somewhere/else"], "ftp"),
        ([original, original, "--rung", "Q0+L0"], "--rung: expected a package"),
        ([original, package, "-o", file], "expected a folder"),
        ([original, package, "-o", file / "below"], "expected a folder"),
    ]
    for arguments, word in cases:
        more = [] if "-o" in arguments else ["-o", out]
        assert airgs_manifest(["compare", *map(str, [*arguments, *more])]) == 2
        line = capsys.readouterr().err
        assert line.count("\n") == 1 and word in line and not out.exists()
