"""Decoded against original pictures: every rung of a package, and one sequence beside another."""

import json

import pytest

from airgs_codec.cli.manifest import main
from airgs_codec.decoder.decode import decode_frames
from airgs_codec.errors import ConfigError
from airgs_codec.inspect.compare import compared_views
from airgs_codec.media.metrics import PSNR_CAP
from airgs_codec.package.store import open_package
from tests.support.paths import VALID
from tests.support.scenes import moving_frames, write_sequence
from tests.support.views import ring

PACKAGE = VALID / "moving"


@pytest.fixture(scope="module")
def top(tmp_path_factory):
    """What the top rung of the package decodes to, as the original."""
    frames = [frame.gaussians for frame in decode_frames(open_package(PACKAGE), 0, 4)]
    return write_sequence(tmp_path_factory.mktemp("compare") / "top", frames)


def figures(capsys, *arguments):
    assert main(["compare", *map(str, arguments), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_every_rung_is_compared_and_the_one_that_was_the_original_is_exact(top, capsys):
    report = figures(capsys, PACKAGE, top)
    assert report["frames"] == [0, 1, 2, 3] and report["views"] == 8
    decoded = report["decoded"]
    assert list(decoded) == ["Q0+L0", "Q0+L1", "Q1+L0", "Q1+L1"]
    assert decoded["Q0+L0"] == {
        "psnr": PSNR_CAP,
        "worst": PSNR_CAP,
        "ssim": pytest.approx(1),
        "delta_e": pytest.approx(0, abs=1e-4),
    }
    for name in ("Q0+L1", "Q1+L0", "Q1+L1"):
        assert decoded[name]["psnr"] < 60 and decoded[name]["ssim"] < 1 and decoded[name]["delta_e"] > 0


def test_one_rung_of_some_frames_is_that_of_all_rungs(top, capsys):
    part = [PACKAGE, top, "--frames", "1:4", "--every", "2"]
    every = figures(capsys, *part)
    one = figures(capsys, *part, "--level", "L1", "--key-quality", "1")
    assert every["frames"] == one["frames"] == [1, 3]
    assert one["decoded"] == {"Q1+L1": every["decoded"]["Q1+L1"]}


def test_two_sequences_are_compared_without_a_package(top, tmp_path, capsys):
    frames = [frame.gaussians for frame in decode_frames(open_package(PACKAGE), 0, 4, level=1, key_quality=1)]
    other = write_sequence(tmp_path / "other", frames)
    assert figures(capsys, other, top)["decoded"]["other"] == figures(capsys, PACKAGE, top)["decoded"]["Q1+L1"]
    assert main(["compare", str(other), str(top)]) == 0
    assert "other" in capsys.readouterr().out


@pytest.mark.parametrize(
    "options",
    [["--level", "L9"], ["--key-quality", "Q9"], ["--frames", "9"], ["--every", "0"], ["--split", "none"]],
)
def test_what_is_not_there_is_refused_in_one_line(top, options, capsys):
    assert main(["compare", str(PACKAGE), str(top), *options]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_sequences_of_other_lengths_and_levels_of_a_sequence_are_refused(top, tmp_path, capsys):
    short = write_sequence(tmp_path / "short", moving_frames(20, 2))
    for arguments in ([PACKAGE, short], [short, top], [top, top, "--level", "L0"]):
        assert main(["compare", *map(str, arguments)]) == 2
        assert capsys.readouterr().err.count("\n") == 1


def test_held_out_cameras_are_taken_where_there_are_any():
    assert [c.split for c in compared_views(ring(4, held_out=1), None)] == ["test"]
    assert len(compared_views(ring(4), None)) == 4
    assert len(compared_views(ring(4, held_out=1), "train")) == 3
    with pytest.raises(ConfigError, match="--split: expected one of train"):
        compared_views(ring(4), "test")
