"""Frames are decoded a few rows at a time, on several threads: the same as all rows at once."""

from dataclasses import fields

import numpy as np
import pytest

from airgs_codec.coding import atlas, kernels, rangecoder
from airgs_codec.decoder.decode import decode_frames
from airgs_codec.package.package import open_package
from tests.support.paths import GOLDEN


@pytest.mark.parametrize("level", [0, 1])
def test_how_many_rows_are_decoded_together_changes_nothing(monkeypatch, level):
    package, frames = open_package(GOLDEN / "fox"), []
    for most in (kernels.LEAST, 1 << 24):
        monkeypatch.setattr(kernels, "CHUNK", 1)
        monkeypatch.setattr(kernels, "LEAST", most)
        frames.append([frame.gaussians for frame in decode_frames(package, 0, 4, level=level)])
    assert len(frames[0][0]) > 2 * 256
    for a, b in zip(*frames, strict=True):
        for f in fields(a):
            np.testing.assert_array_equal(getattr(a, f.name), getattr(b, f.name))


@pytest.mark.parametrize("case", sorted(path.stem for path in GOLDEN.glob("*.json")))
def test_compiled_loops_give_the_bits_that_numpy_gives(monkeypatch, case):
    frames = []
    for compiled in (lambda loop, numbers: None, lambda loop, numbers: rangecoder._compiled(loop)):
        for module in (atlas, kernels):
            monkeypatch.setattr(module, "worth_compiling", compiled)
        package = open_package(GOLDEN / case)
        levels = range(len(package.manifest.levels))
        stop = package.manifest.frames
        frames.append([f.gaussians for level in levels for f in decode_frames(package, 0, stop, level=level)])
    for a, b in zip(*frames, strict=True):
        assert all(getattr(a, f.name).tobytes() == getattr(b, f.name).tobytes() for f in fields(a))
