"""Packages that grow: what is on the disk is whole after every group, and what is in memory does not grow."""

from dataclasses import replace
from datetime import UTC, datetime

import pytest

from tests.faces import (
    PAGE,
    Folder,
    FormatError,
    Groups,
    GrowingPackage,
    LiveClock,
    open_package,
    root_of,
    validate,
    write_root,
    write_tables,
)
from tests.support.growing import PAGED
from tests.support.mutations import read_files

NOW = datetime(2026, 1, 1, tzinfo=UTC)


@pytest.fixture(scope="module")
def whole():
    return open_package(PAGED).manifest


@pytest.fixture
def growing(whole, tmp_path):
    for name, data in read_files(PAGED).items():
        if name.startswith(("key/", "state/", "init")):
            Folder(tmp_path).write(name, data)
    m = replace(whole, live=True, frames=whole.groups[0].stop, groups=Groups.of(whole.groups[:1]))
    write_tables(Folder(tmp_path), m, LiveClock(NOW, NOW))
    return GrowingPackage(Folder(tmp_path), m, NOW)


def test_the_package_ends_as_if_written_at_once(whole, growing, tmp_path):
    for group in whole.groups[1:]:
        growing.add(group)
    assert len(growing.manifest.groups._kept) <= 2  # tables are read again where they are wanted
    growing.close()
    assert validate(tmp_path) == []
    assert read_files(tmp_path) == read_files(PAGED)
    assert growing.manifest.groups[3] == whole.groups[3] and len(growing.manifest.segments) == len(whole.segments)


def test_a_group_is_expected_without_being_written(whole, growing, tmp_path):
    for group in whole.groups[1 : PAGE - 1]:
        growing.add(group)
    before = read_files(tmp_path)
    expected = growing.expect(whole.groups[PAGE - 1])  # it fills the page
    assert [expected.groups[i] for i in (0, PAGE - 1)] == [whole.groups[i] for i in (0, PAGE - 1)]
    assert expected.frames == whole.groups[PAGE - 1].stop and read_files(tmp_path) == before
    growing.add(whole.groups[PAGE - 1])
    assert root_of(growing.manifest) == root_of(expected) == root_of(open_package(tmp_path).manifest)


def test_what_no_reader_takes_is_not_written(whole, growing, tmp_path):
    before = read_files(tmp_path)
    with pytest.raises(FormatError, match=r"group/2\.json\.gz"):
        growing.add(replace(whole.groups[1], static=-1))
    with pytest.raises(FormatError, match="fov_y"):
        write_root(Folder(tmp_path), replace(whole, region=replace(whole.region, fov_y=179.99)))
    assert read_files(tmp_path) == before and len(growing.manifest.groups) == 1
