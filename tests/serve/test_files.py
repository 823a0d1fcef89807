"""Files of packages at the moment of a request: nothing but they."""

import os
import shutil

import pytest

from airgs_codec.serve.app import find_file
from tests.faces import ConfigError, Packages, media_type
from tests.support.paths import VALID

PACKAGE = VALID / "two-groups-sh1"
STATE = "state/L0/1.m4s"


@pytest.fixture
def package(tmp_path):
    return shutil.copytree(PACKAGE, tmp_path / "two.airgs")


@pytest.mark.parametrize(
    ("path", "expected"),
    [
        ("airgs.json", "application/json"),
        ("manifest.mpd", "application/dash+xml"),
        ("index/1/12.json", "application/json"),
        ("group/7.json.gz", "application/gzip"),
        ("key/T0/1.bin", "application/octet-stream"),
        ("init.mp4", "video/mp4"),
        (STATE, "video/mp4"),
        *((path, None) for path in ("", "notes.json", "airgs.json/", "key", "key/T0/notes.txt", "x/1.bin")),
        *((path, None) for path in ("key/../airgs.json", "key/./1.bin", "/airgs.json", "key//1.bin", "key/.b.bin")),
        *((path, None) for path in (".airgs.json.part", "airgs.json\n", "key/T0/1.bin\0", "key\\1.bin", "key/é/1.bin")),
    ],
)  # fmt: skip
def test_a_path_has_a_type_or_is_none_of_a_package(path, expected):
    assert media_type(path) == expected


def test_links_folders_and_what_is_no_plain_file_are_not_there(package, tmp_path):
    (tmp_path / "secret.m4s").write_bytes(b"secret")
    (package / "state/L0/8.m4s").symlink_to(tmp_path / "secret.m4s")
    (package / "state/L0/9.m4s").symlink_to(package / STATE)
    (package / "state/L0/10.m4s").symlink_to("10.m4s")
    (package / "state/L9").symlink_to(package / "state/L0")
    (package / "state/L0/7.m4s").mkdir()
    os.mkfifo(package / "state/L0/6.m4s")
    (tmp_path / "linked").symlink_to(package)
    for folder in (package, tmp_path / "linked"):
        file, status = find_file(folder, STATE)
        assert file == str(package / STATE) and status.st_size == (PACKAGE / STATE).stat().st_size
    for path in (*(f"state/L0/{n}.m4s" for n in (6, 7, 8, 9, 10, 11)), "state/L9/1.m4s", f"{STATE}/1.m4s", "x" * 9000):
        assert find_file(package, path) is None, path


def test_folders_must_be_packages_of_different_names(package, tmp_path):
    with pytest.raises(ConfigError, match=r"nothing.*expected a package"):
        Packages([tmp_path / "nothing"])
    (tmp_path / "frames").mkdir()
    assert list(Packages([package, tmp_path / "frames"]).now()) == ["two.airgs"]
    (tmp_path / "frames" / "0.ply").touch()
    with pytest.raises(ConfigError, match=r"frames: expected a package.*, a folder with packages or an empty one"):
        Packages([package, tmp_path / "frames"])
    other = shutil.copytree(package, tmp_path / "other" / "two.airgs")
    for second in (other, other.parent):
        with pytest.raises(ConfigError, match="twice"):
            Packages([package, second])


def test_of_two_packages_of_one_name_the_one_that_was_named_first_is_served(package, tmp_path):
    shelves = [tmp_path / "a", tmp_path / "b"]
    for shelf, name in zip(shelves, ("x", "y"), strict=True):
        shutil.copytree(package, shelf / name)
    packages = Packages([*shelves, package])
    for name in ("x", "y", "two.airgs"):
        for shelf in shelves:
            shutil.copytree(package, shelf / name, dirs_exist_ok=True)
    expected = {"two.airgs": package, "x": shelves[0] / "x", "y": shelves[0] / "y"}
    assert packages.now() == expected
