"""What a viewer has of a package: tiers and tiles, some of which may have no rows."""

from dataclasses import replace

import pytest

from airgs_codec.decoder.decode import Part, decode_canonical, decode_frames
from airgs_codec.errors import ConfigError
from airgs_codec.package.manifest import Groups
from airgs_codec.package.package import Package, open_package
from airgs_codec.package.tables import NO_FILE
from tests.support.paths import GOLDEN


@pytest.fixture(scope="module")
def package():
    return open_package(GOLDEN / "tiles")


def test_a_tile_without_rows_decodes_to_none(package):
    """Its tables are emptied; those of the others stay."""
    m = package.manifest
    groups = [_without_first(group) for group in m.groups]
    emptied = Package(package.files, replace(m, groups=Groups.of(groups)), 0)
    alone = list(decode_frames(emptied, 0, m.frames, part=Part(tiles=[0])))
    assert [len(frame.gaussians) for frame in alone] == [0] * m.frames
    both = list(decode_frames(emptied, 0, m.frames, part=Part(tiles=[0, 1])))
    second = list(decode_frames(package, 0, m.frames, part=Part(tiles=[1])))
    assert [frame.gaussians.means.tolist() for frame in both] == [frame.gaussians.means.tolist() for frame in second]


def _without_first(group):
    first = group.tiles[0]
    files = [NO_FILE] * len(first.tiers[0].pictures)
    tiers = [replace(tier, count=0, sidecar=NO_FILE, pictures=files) for tier in first.tiers]
    segments = [replace(s, levels=[_without_file(level) for level in s.levels]) for s in group.segments]
    count = group.count - sum(tier.count for tier in first.tiers)
    tiles = [replace(first, tiers=tiers), *group.tiles[1:]]
    return replace(group, count=count, tiles=tiles, segments=segments)


def _without_file(level):
    return replace(level, files=[NO_FILE, *level.files[1:]], frame_bytes=[[], *level.frame_bytes[1:]])


@pytest.mark.parametrize("tiers", [-1, 0, 3])
def test_tiers_that_a_package_does_not_have_are_refused(package, tiers):
    with pytest.raises(ConfigError, match=rf"tiers: expected 1\.\.2, got {tiers}"):
        decode_canonical(package, 0, 0, tiers)
