"""Decoded against original pictures: every rung of a package."""

import json

import pytest

from airgs_codec.cli.manifest import main
from airgs_codec.decoder.decode import decode_frames
from airgs_codec.errors import ConfigError
from airgs_codec.inspect.compare import compared_views, region_views
from airgs_codec.media.metrics import PSNR_CAP
from airgs_codec.package.store import open_package
from tests.support.multiview_files import write_cameras
from tests.support.paths import VALID
from tests.support.regions import arc
from tests.support.scenes import moving_frames, write_sequence
from tests.support.views import ring

PACKAGE = VALID / "moving"


@pytest.fixture(scope="module")
def top(tmp_path_factory):
    """What the top rung of the package decodes to, as the original."""
    frames = [frame.gaussians for frame in decode_frames(open_package(PACKAGE), 0, 4)]
    return write_sequence(tmp_path_factory.mktemp("compare") / "top", frames)


def figures(capsys, *arguments):
    draws = [] if "--draws" in arguments else ["--draws", "2"]
    assert main(["rungs", *map(str, arguments), *draws, "--json"]) == 0
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
    assert main(["rungs", *map(str, rung), "--draws", "1"]) == 0
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
    assert main(["rungs", str(PACKAGE), str(top), *options]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_sequences_of_other_lengths_and_what_is_no_package_are_refused(top, tmp_path, capsys):
    short = write_sequence(tmp_path / "short", moving_frames(20, 2))
    for arguments in ([PACKAGE, short], [short, top]):
        assert main(["rungs", *map(str, arguments)]) == 2
        assert capsys.readouterr().err.count("\n") == 1


def test_held_out_cameras_are_taken_where_there_are_any():
    assert [c.split for c in compared_views(ring(4, held_out=1), None)] == ["test"]
    assert len(compared_views(ring(4), None)) == 4
    drawn = region_views(arc(90, 3, 1.0), 5, 2)
    assert [c.split for c in compared_views([*ring(4, held_out=1), *drawn], None)] == ["test"] + ["region"] * 5
    assert len(compared_views([*ring(4), *drawn], None)) == 9
    assert len(compared_views(ring(4, held_out=1), "train")) == 3
    with pytest.raises(ConfigError, match="--split: expected one of train"):
        compared_views(ring(4), "test")
