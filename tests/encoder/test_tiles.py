"""Groups in tiles: what belongs to which, and that each is coded and decoded apart from the others."""

from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.decoder.decode import Part, decode_canonical, decode_frames
from airgs_codec.encoder.plan import assign_tiles, find_box
from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import EncodeSettings, LevelSettings
from airgs_codec.errors import ConfigError, FormatError
from airgs_codec.inspect.errors import measure_errors
from airgs_codec.inspect.validate import exceeded, validate
from airgs_codec.package.package import open_package
from airgs_codec.scene.gaussians import join_rows
from airgs_codec.scene.sequence import open_sequence
from tests.support.regions import region
from tests.support.rooms import room_frames
from tests.support.scenes import write_sequence

TILES = 4
LEVELS = (LevelSettings(0.0), LevelSettings(0.3, 2.0, tiers=1, quality=1))
SETTINGS = EncodeSettings(
    calibrate="none", levels=LEVELS, tiles=TILES, keep_all=True, measure_pictures=2, group_frames=3, segment_s=0.07
)


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """A room of two groups, of which the second keeps walls of the first, in tiles: the package and its scene."""
    folder = tmp_path_factory.mktemp("tiles")
    scene = open_sequence(write_sequence(folder / "scene", room_frames(400, 6, degree=1)))
    encode(scene, folder / "package", replace(SETTINGS, region=region()))
    return open_package(folder / "package"), scene


@pytest.mark.parametrize("count", [1, 2, 3, 7, 64])
@pytest.mark.parametrize("rows", [1, 5, 64, 1000])
def test_tiles_hold_equally_many_rows(rows, count):
    means = np.random.default_rng(rows).normal(size=(rows, 3)) * [5, 1, 1]
    counts = np.bincount(assign_tiles(means, count), minlength=count)
    assert counts.sum() == rows and len(counts) == count
    assert counts.max() - counts.min() <= np.ceil(np.log2(count))  # each halving rounds once


def test_tiles_are_apart_from_each_other_on_some_axis():
    means = np.random.default_rng(3).normal(size=(2000, 3)) * [3, 2, 1]
    tiles = assign_tiles(means, 8)
    boxes = [(means[tiles == p].min(axis=0), means[tiles == p].max(axis=0)) for p in range(8)]
    for a in range(8):
        for b in range(a):
            assert (boxes[a][0] >= boxes[b][1]).any() or (boxes[b][0] >= boxes[a][1]).any()


def test_a_box_holds_nearly_all_means_in_all_frames():
    frames = room_frames(500, 5)
    rows = np.arange(100, 500)
    low, high = find_box(frames, rows)
    for frame in frames:
        inside = (frame.means[rows] >= low) & (frame.means[rows] <= high)
        assert inside.mean(axis=0).min() > 0.975
    assert find_box(frames, rows[:0]) == ([0.0] * 3, [0.0] * 3)


def test_a_package_of_tiles_is_whole_and_keeps_its_promises(room):
    package, scene = room
    m = package.manifest
    assert m.tiles == TILES and [len(group.tiles) for group in m.groups] == [TILES] * 2
    assert m.groups[1].keeps == 1
    assert validate(package.files.path) == []
    measured = list(measure_errors(package, scene))
    assert not exceeded(measured) and {m.where for m in measured} >= {"group 1 key P2/T0 Q1", "group 0 state P4/L1"}


@pytest.mark.parametrize("level", [0, 1])
def test_each_tile_decodes_by_itself_to_its_rows_of_the_whole(room, level):
    package, _ = room
    m = package.manifest
    quality = m.levels[level].quality
    whole = list(decode_frames(package, 0, m.frames, level=level, key_quality=quality))
    parts = [
        list(decode_frames(package, 0, m.frames, level=level, key_quality=quality, part=Part(tiles=[p])))
        for p in range(4)
    ]
    some = list(decode_frames(package, 0, m.frames, level=level, key_quality=quality, part=Part(tiles=[3, 1])))
    for t, frame in enumerate(whole):
        for joined, of in ((frame, range(4)), (some[t], (1, 3))):
            expected = join_rows([parts[p][t].gaussians for p in of])
            for name in ("means", "quaternions", "log_scales", "opacity_logits", "sh_dc", "sh_rest"):
                np.testing.assert_array_equal(getattr(joined.gaussians, name), getattr(expected, name))


def test_fewer_tiers_are_those_of_every_tile(room):
    package, _ = room
    m = package.manifest
    first = decode_canonical(package, 0, 0, tiers=1)
    assert len(first.means) == sum(tile.tiers[0].count for tile in m.groups[0].tiles)
    fewer = list(decode_frames(package, 0, 3, level=0, part=Part(1)))  # of a level that would have both
    rows = np.concatenate([
        np.arange(tile.tiers[0].count) + sum(unit.count for unit in m.groups[0].units[: 2 * p])
        for p, tile in enumerate(m.groups[0].tiles)
    ])  # fmt: skip
    for few, all_ in zip(fewer, decode_frames(package, 0, 3, level=0), strict=True):
        np.testing.assert_array_equal(few.gaussians.means, all_.gaussians.means[rows])


def test_tiles_do_not_change_what_is_shown_beyond_the_steps(tmp_path):
    scene = open_sequence(write_sequence(tmp_path / "scene", room_frames(1200, 6, degree=1)))  # 60 rows move
    found = []
    for tiles in (1, TILES):  # of one tier: those have steps of their own
        settings = replace(SETTINGS, region=region(), tiles=tiles, tiers=(1.0,))
        encode(scene, tmp_path / f"{tiles}", settings)
        found.append(open_package(tmp_path / f"{tiles}").manifest)
    one, many = found
    for tiled, whole in zip(many.segments, one.segments, strict=True):
        assert abs(tiled.levels[0].psnr[0] - whole.levels[0].psnr[0]) < 1.0
    assert [group.count for group in one.groups] == [group.count for group in many.groups]
    assert [group.static for group in one.groups] == [group.static for group in many.groups]


def test_more_tiles_than_rows_leave_some_empty(tmp_path):
    scene = open_sequence(write_sequence(tmp_path / "scene", room_frames(2, 3)))
    encode(scene, tmp_path / "package", replace(SETTINGS, region=region(), tiles=8, measure_pictures=0))
    package = open_package(tmp_path / "package")
    counts = [sum(tier.count for tier in tile.tiers) for tile in package.manifest.groups[0].tiles]
    assert 0 in counts and validate(package.files.path) == []
    assert [len(frame.gaussians) for frame in decode_frames(package, 0, 3)] == [sum(counts)] * 3


def test_paths_and_tiles_that_a_package_does_not_have_are_refused(room):
    package, _ = room
    assert package.manifest.entry("key/P4/T0/1.bin").bytes
    for path in ("key/T0/1.bin", "key/P5/T0/1.bin", "state/L0/1.m4s", "state/P5/L0/1.m4s"):
        with pytest.raises(FormatError, match="no table has such a file"):
            package.manifest.entry(path)
    for tiles in ([4], [-1], []):
        with pytest.raises(ConfigError, match=r"tiles: expected some of 0\.\.3"):
            list(decode_frames(package, 0, 1, part=Part(tiles=tiles)))
    with pytest.raises(ConfigError, match="expected 1 to 64 tiles, got 65"):
        EncodeSettings(tiles=65)
