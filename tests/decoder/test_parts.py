"""What a viewer has of a package: its first key tiers, some of which may have no rows."""

from dataclasses import replace

import pytest

from airgs_codec.decoder.decode import decode_canonical, decode_frames
from airgs_codec.errors import ConfigError
from airgs_codec.package.manifest import Groups
from airgs_codec.package.package import Package, open_package
from airgs_codec.package.tables import NO_FILE
from tests.support.paths import GOLDEN


@pytest.fixture(scope="module")
def package():
    return open_package(GOLDEN / "room")


def test_a_tier_without_rows_decodes_to_none(package):
    """Its tables are emptied."""
    m = package.manifest
    emptied = Package(package.files, replace(m, groups=Groups.of([_without_first(group) for group in m.groups])), 0)
    alone = list(decode_frames(emptied, 0, m.frames, tiers=1))
    assert [len(frame.gaussians) for frame in alone] == [0] * m.frames
    both, second = decode_canonical(emptied, 0, 0, 2), decode_canonical(package, 0, 0)
    assert both.means.tolist() == second.means[m.groups[0].tiers[0].count :].tolist()


def _without_first(group):
    first, second = group.tiers
    empty = replace(first, count=0, sidecar=NO_FILE, pictures=[NO_FILE] * len(first.pictures))
    return replace(group, count=second.count, tiers=[empty, second])


@pytest.mark.parametrize("tiers", [-1, 0, 3])
def test_tiers_that_a_package_does_not_have_are_refused(package, tiers):
    with pytest.raises(ConfigError, match=rf"tiers: expected 1\.\.2, got {tiers}"):
        decode_canonical(package, 0, 0, tiers)
