"""The tables' paths: what a file carries follows from where it is."""

from airgs_codec.package import tables
from airgs_codec.package.tables import FileKind, file_kind


def test_kinds_of_files_are_those_of_their_paths():
    assert file_kind(tables.JSON_NAME) is file_kind(tables.MPD_NAME) is FileKind.MANIFESTS
    assert file_kind(tables.key_init_path(0, 1)) is file_kind(tables.state_init_path(2)) is FileKind.INIT
    assert file_kind(tables.key_media_path(0, 1, 3)) is FileKind.KEY
    assert file_kind(tables.state_media_path(2, 3)) is FileKind.STATE
    for path in (
        tables.key_sidecar_path(0, 3),
        tables.key_detail_path(0, 1, 3),
        tables.state_sidecar_path(2, 3),
    ):
        assert file_kind(path) is FileKind.SIDECARS
