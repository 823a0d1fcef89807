"""What is left out is noted, and only where it may be."""

from dataclasses import replace

import numpy as np

from airgs_codec.decoder.decode import decode_frames
from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.inspect.validate import validate
from airgs_codec.package.package import open_package
from airgs_codec.scene.sequence import open_sequence
from tests.support.paths import FOX
from tests.support.scenes import moving_frames, write_sequence

FAST = EncodeSettings(preset="veryfast", threads=2)


def test_keep_all_keeps_all(demo_package, tmp_path):
    settings = replace(FAST, keep_all=True, measure_pictures=0, calibrate="none")
    everything, less = (
        encode(open_sequence(FOX), tmp_path / "all", settings).manifest,
        open_package(demo_package).manifest,
    )
    assert all(g.unused == 0 for g in everything.groups)
    assert {entry.what for group in everything.groups for entry in group.left_out} <= {"updates"}
    assert all(g.unused > 0 for g in less.groups)
    noted = [entry for group in less.groups for entry in group.left_out if entry.what == "gaussians"]
    assert [entry.count for entry in noted] == [g.unused for g in less.groups]
    assert all(entry.error > 0 and entry.bytes > 0 for entry in noted)


def test_bands_that_do_not_show_are_left_out(tmp_path):
    frames = moving_frames(400, 3, degree=3)
    rest = np.random.default_rng(0).normal(0, 0.5, frames[0].sh_rest.shape).astype(np.float32)
    rest[:, 3:] = 0
    sequence = open_sequence(write_sequence(tmp_path / "scene", [replace(g, sh_rest=rest) for g in frames]))
    encode(sequence, tmp_path / "out", FAST)
    package = open_package(tmp_path / "out")
    assert validate(tmp_path / "out") == []
    assert package.manifest.sh_degree == 1
    assert any(line.startswith("2 SH bands left out: ") for line in package.manifest.decisions)
    assert next(decode_frames(package, 0, 1)).gaussians.sh_rest.shape[1] == 3
