"""Frames are decoded a few rows at a time, on several threads: the same as all rows at once."""

from dataclasses import fields

import numpy as np
import pytest

from airgs_codec.coding import atlas, kernels, rangecoder
from airgs_codec.coding.atlas import read_codes
from airgs_codec.decoder.decode import decode_frames
from airgs_codec.decoder.states import decode_pictures
from airgs_codec.package.package import open_package
from airgs_codec.package.tables import Atlas
from tests.support.paths import GOLDEN, VALID


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


def test_the_codes_of_some_rows_are_those_of_all_of_them():
    random = np.random.default_rng(0)
    atlas = Atlas(1000, [7, -3, 0], [0, 2], 64, 2)
    picture = random.integers(16, 236, (256, 128)).astype(np.uint8)
    bases = random.integers(-2, 3, (2, 1000)).astype(np.int32)
    whole = read_codes(picture, atlas, bases)
    np.testing.assert_array_equal(read_codes(picture, atlas, bases, slice(300, 555)), whole[:, 300:555])
    assert (whole[1] == -3).all() and len(np.unique(whole[0])) > 100


def test_frames_of_a_segment_come_in_order_and_stop_where_they_are_asked_to():
    package = open_package(VALID / "moving")
    every = [shown.codes() for shown in decode_pictures(package, 0, 0, range(4))]
    some = [shown.codes() for shown in decode_pictures(package, 0, 0, range(1, 3))]
    assert len(every) == 4 and not np.array_equal(every[0], every[1])
    assert all(np.array_equal(a, b) for a, b in zip(some, every[1:3], strict=True))
