"""Lines in time: where they pay, what they promise, and frames that are read in any order."""

from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.coding.atlas import line_times
from airgs_codec.encoder.sample import encode_and_decode, fit_slopes, worth_line
from airgs_codec.media.h264 import state_codec
from airgs_codec.media.mp4 import read_segment
from tests.faces import (
    EncodeSettings,
    Gaussians,
    LevelSettings,
    airgs_manifest,
    decode,
    decode_frames,
    decode_pictures,
    encode,
    measure_errors,
    open_package,
    open_sequence,
)
from tests.support.digests import decode_slopes
from tests.support.scenes import frozen, random_gaussians, write_sequence

FRAMES, SEGMENT = 17, 8  # the last group has one frame
SETTINGS = EncodeSettings(
    calibrate="none",
    measure_pictures=0,
    preset="veryfast",
    threads=1,
    group_frames=2 * SEGMENT,
    segment_s=SEGMENT / 30,
    keep_all=True,
    levels=(LevelSettings(0.0), LevelSettings(0.3, 2.0)),
)


def drifting(count: int = 900) -> list[Gaussians]:
    """Every row moves evenly in a way of its own, turns and changes its colour; some go and come, some jump far."""
    rng, first = np.random.default_rng(3), random_gaussians(count)
    way, turn, dye = (rng.normal(size=(count, n)) * size for n, size in ((3, 0.02), (4, 0.01), (3, 0.02)))
    way[:5] *= 200  # past what 8 bits hold, slopes too
    coming = np.arange(count) % 7 == 0

    def frame(t: int) -> Gaussians:
        logits = np.where(coming & (t % 6 < 3), -9, first.opacity_logits)
        columns = first.means + t * way, first.quaternions + t * turn, first.log_scales, logits, first.sh_dc + t * dye
        return frozen(Gaussians(*(column.astype(np.float32) for column in columns), first.sh_rest))

    return [frame(t) for t in range(FRAMES)]


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return open_sequence(
        write_sequence(tmp_path_factory.mktemp("drift") / "scene", drifting(), fps=30, keyframes=[0, FRAMES - 1])
    )


@pytest.fixture(scope="module")
def package(scene, tmp_path_factory):
    folder = tmp_path_factory.mktemp("drift") / "out"
    encode(scene, folder, SETTINGS)
    return open_package(folder)


def test_segments_of_even_motion_have_lines_and_those_of_one_frame_have_none(package):
    lines = [[level.line for level in segment.levels] for segment in package.manifest.segments]
    assert lines == [[True, True], [True, True], [None, None]]


def test_every_error_is_within_its_bound_and_files_are_what_they_promise(package, scene, capsys):
    measured = list(measure_errors(package, scene))
    assert all(m.error <= m.bound for m in measured), [m for m in measured if m.error > m.bound]
    assert max(m.error / m.bound for m in measured if "state" in m.where and m.bound) > 0.5
    assert airgs_manifest(["validate", str(package.files.name), "--against", str(scene.folder)]) == 0


def test_frames_that_are_read_alone_are_those_of_a_whole_segment(package):
    whole = [frame.gaussians for frame in decode_frames(package, 0, FRAMES)]
    for number in (0, 5, 7, 8, 12, 16):
        alone = decode(package, number)
        for name in alone.__slots__:
            np.testing.assert_array_equal(getattr(alone, name), getattr(whole[number], name))


def test_slopes_are_what_rows_rise_by_and_frames_hold_the_rest(package):
    codes = np.stack([shown.codes() for shown in decode_pictures(package, 0, 0, range(SEGMENT))])
    slopes = decode_slopes(package, 0, 0)
    gain = package.manifest.state_gain
    assert np.ptp(slopes[:3], axis=1).max() > 20 * gain  # of means, some past 8 bits
    left = fit_slopes(codes[:, :3].astype(np.float64))
    assert np.abs(left).mean() < gain / 2 < np.abs(slopes[:3]).mean()


def test_the_picture_of_slopes_stands_in_front_and_shares_the_time(package):
    (path,) = package.manifest.state_files(0, 0)
    segment = package.manifest.segments[0].levels[0]
    found = read_segment(package.read(path))
    assert len(found.samples) == len(found.checksums) == SEGMENT + 1
    assert len(segment.frame_bytes) == SEGMENT and segment.frame_bytes[0] > len(found.samples[0]) // 2


def test_a_line_is_taken_where_it_saves_bytes_alone():
    rng, codec = np.random.default_rng(0), state_codec("fast")
    start, rise, noise = rng.normal(size=(3, 512)) * 30, rng.normal(size=(3, 512)) * 20, rng.normal(size=(12, 3, 512))
    even = start + line_times(12)[:, None, None] * rise
    steps, weights = np.ones(3), np.ones((3, 512))
    assert worth_line(even, steps, weights, codec)
    assert not worth_line(start + 20 * noise, steps, weights, codec)
    assert not worth_line(even[:1], steps, weights, codec)
    sizes, decoded = encode_and_decode(even, steps, codec, line=True)
    assert len(sizes) == 12 and np.abs(decoded - even).max() < 4


def test_segments_of_one_frame_have_files_and_no_line(tmp_path):
    sequence = open_sequence(write_sequence(tmp_path / "scene", drifting(300)[:4], fps=30))
    encode(sequence, tmp_path / "out", replace(SETTINGS, segment_s=1 / 30))
    package = open_package(tmp_path / "out")
    assert [segment.levels[0].line for segment in package.manifest.segments] == [None] * 4
    assert sum(segment.levels[0].file.bytes > 0 for segment in package.manifest.segments) > 2
    assert decode_slopes(package, 3, 0) is None
    assert all(m.error <= m.bound for m in measure_errors(package, sequence))


def test_a_scene_of_uneven_motion_has_no_lines(tmp_path):
    rng, first = np.random.default_rng(1), random_gaussians(300)
    shaken = [frozen(replace(first, means=first.means + rng.normal(size=(300, 3)).astype("f4") / 9)) for _ in range(8)]
    sequence = open_sequence(write_sequence(tmp_path / "scene", shaken, fps=30))
    table = encode(sequence, tmp_path / "out", replace(SETTINGS, group_frames=8)).manifest
    assert all(level.line is None for segment in table.segments for level in segment.levels)
    assert open_package(tmp_path / "out").manifest.segments[0].levels[0].file.bytes
