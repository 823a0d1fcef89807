"""The tables' paths: what a file carries follows from where it is."""

import pytest

from airgs_codec.package import layout
from tests.faces import FileKind, file_kind, locate


def test_kinds_of_files_are_those_of_their_paths():
    for path in (layout.JSON_NAME, layout.MPD_NAME, layout.group_path(3), layout.page_path(2, 1)):
        assert file_kind(path) is FileKind.MANIFESTS
    assert file_kind(layout.INIT_NAME) is FileKind.INIT
    assert file_kind(layout.key_media_path(0, 1, 3)) is FileKind.KEY
    assert file_kind(layout.state_media_path(2, 3)) is FileKind.STATE
    assert file_kind(layout.key_sidecar_path(0, 3)) is FileKind.SIDECARS


def test_paths_are_found_again():
    assert locate(layout.key_sidecar_path(0, 30)) == ("sidecar", (0, 30))
    assert locate(layout.key_media_path(1, 12, 3)) == ("key", (1, 12, 3))
    assert locate(layout.state_media_path(2, 3)) == ("state", (2, 3))
    assert locate(layout.group_path(7200)) == ("group", (7200,)) and locate(layout.page_path(2, 1)) == ("page", (2, 1))


@pytest.mark.parametrize(
    "path",
    [
        "",
        "key/T0/0.bin",
        "key/T01/1.bin",
        "key/T0/1.bin/..",
        "../key/T0/1.bin",
        "state/L0/x.m4s",
        "group/1.json",
        "state/P1/L0/1.m4s",
    ],
)
def test_other_paths_are_no_paths_of_a_package(path):
    assert locate(path) == ("", ())
