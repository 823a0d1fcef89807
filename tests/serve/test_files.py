"""Files of packages at the moment of a request: nothing but they, and one version at a time."""

import asyncio
import gzip
import hashlib
import os
import shutil
import time

import pytest

from airgs_codec.errors import ConfigError, TransportError
from airgs_codec.package.tables import digest, shorten
from airgs_codec.places.whole import write_bytes
from airgs_codec.serve import files as module
from airgs_codec.serve.files import PackageFiles, media_type
from tests.support.mutations import read_files
from tests.support.paths import VALID

PACKAGE = VALID / "two-groups-sh1"
STATE = "state/L0/1.m4s"


@pytest.fixture
def package(tmp_path):
    return shutil.copytree(PACKAGE, tmp_path / "two.airgs")


def read(files, path, name="two.airgs"):
    return asyncio.run(files.read(name, path))


def whole(version):
    return version.read(0, version.size)


def age(path, seconds=60.0):
    """As if the file had been written before; its inode still changes now."""
    then = time.time_ns() - int(1e9 * seconds)
    os.utime(path, ns=(then, then))


def test_every_file_of_a_package_is_there_with_its_digest(package):
    files = PackageFiles([package])
    for path, data in read_files(package).items():
        snapshot = read(files, path)
        assert whole(snapshot.plain) == data and shorten(snapshot.plain.sha256) == digest(data)
        assert snapshot.plain.read(3, 7) == data[3:7]
        assert snapshot.lasting == (path not in ("airgs.json", "manifest.mpd"))
        assert (snapshot.zipped is not None) == (path.endswith((".json", ".mpd")) and len(data) >= 1024)
        assert snapshot.zipped is None or gzip.decompress(whole(snapshot.zipped)) == data


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
    (package / "state/L9").symlink_to(package / "state/L0")
    (package / "state/L0/7.m4s").mkdir()
    os.mkfifo(package / "state/L0/6.m4s")
    files = PackageFiles([package])
    assert read(files, STATE)
    for path in ("state/L0/8.m4s", "state/L0/9.m4s", "state/L9/1.m4s", "state/L0/7.m4s", "state/L0/6.m4s"):
        assert read(files, path) is None, path
    assert read(files, STATE, "other.airgs") is None and read(files, f"{STATE}/1.m4s") is None


def test_a_growing_package_is_served_as_it_is_now(package, monkeypatch):
    monkeypatch.setattr(module, "SETTLED_NS", 0)  # everything may come from memory
    files = PackageFiles([package])
    root = read(files, "airgs.json")
    assert read(files, "airgs.json") is root
    assert read(files, "state/L0/99.m4s") is None
    write_bytes(package / "state/L0/99.m4s", b"new")
    write_bytes(package / "airgs.json", b"{}")
    assert whole(read(files, "state/L0/99.m4s").plain) == b"new"
    assert whole(read(files, "airgs.json").plain) == b"{}"
    assert whole(root.plain) == (PACKAGE / "airgs.json").read_bytes()  # to those who asked for it before
    shutil.rmtree(package)
    assert read(files, "airgs.json") is None
    shutil.copytree(PACKAGE, package)
    assert whole(read(files, "airgs.json").plain) == whole(root.plain)


def test_a_young_file_is_read_anew_because_its_time_stamp_may_not_tell(package):
    """Two versions of one length within a tick of the clock."""
    files, path = PackageFiles([package]), package / STATE
    for data in (b"first", b"other"):
        path.write_bytes(data)
        assert whole(read(files, STATE).plain) == data


def test_a_file_in_memory_is_known_by_all_of_its_stamp(package, monkeypatch):
    """A file of the same length and time takes its place, as `cp -p` and rsync do."""
    monkeypatch.setattr(module, "SETTLED_NS", 0)
    files, path = PackageFiles([package]), package / STATE
    path.write_bytes(b"first")
    age(path)
    first = read(files, STATE)
    assert whole(first.plain) == b"first"
    shutil.copystat(path, shutil.copy(package / "airgs.json", package / "copy"))
    (package / "copy").write_bytes(b"other")
    shutil.copystat(path, package / "copy")
    (package / "copy").replace(path)
    assert whole(read(files, STATE).plain) == b"other"
    with pytest.raises(TransportError, match="another"):  # no part of this one under the tag of the first
        whole(first.plain)


def test_a_file_that_is_being_written_is_not_served(package, monkeypatch):
    """Every look finds it longer."""
    monkeypatch.setattr(module, "PAUSE_S", 0.0)
    path, stamp = package / STATE, module._stamp

    def growing(descriptor):
        with path.open("ab") as file:
            file.write(b"x")
        return stamp(descriptor)

    monkeypatch.setattr(module, "_stamp", growing)
    with pytest.raises(TransportError, match="being written"):
        read(PackageFiles([package]), STATE)


def test_memory_is_bounded(package, monkeypatch):
    monkeypatch.setattr(module, "SETTLED_NS", 0)
    files = PackageFiles([package], cache_bytes=50_000)
    for number in range(100, 120):
        (package / "index").mkdir(exist_ok=True)
        (package / f"index/{number}.json").write_bytes(os.urandom(4000))
    (package / "index/200.json").write_bytes(bytes(60_000))
    kept = [read(files, f"index/{number}.json") for number in range(100, 120)]
    assert read(files, "index/119.json") is kept[-1] and read(files, "index/100.json") is not kept[0]
    assert len(files._cache) <= 6 and files._held_bytes <= 50_000
    assert len(whole(read(files, "index/200.json").plain)) == 60_000 and files._held_bytes <= 50_000


def test_of_pictures_and_long_texts_only_the_digest_is_kept(package, monkeypatch):
    monkeypatch.setattr(module, "SETTLED_NS", 0)
    monkeypatch.setattr(module, "MOST_HELD_BYTES", 1 << 20)
    files = PackageFiles([package])
    for path in (STATE, "airgs.json"):
        (package / path).write_bytes(bytes(3 << 20))
        snapshot = read(files, path)
        assert snapshot.plain.sha256 == hashlib.sha256(bytes(3 << 20)).digest() and snapshot.zipped is None
        assert read(files, path) is snapshot and snapshot.plain.read(5, 7) == bytes(2)
    assert files._held_bytes < 10_000


def test_all_who_ask_at_once_wait_for_one_digest(package, monkeypatch):
    loads, load = [], module._load
    monkeypatch.setattr(module, "_load", lambda *file: loads.append(file) or load(*file))
    files = PackageFiles([package])

    async def ask():
        return await asyncio.gather(*(files.read("two.airgs", STATE) for _ in range(40)))

    assert len(set(map(id, asyncio.run(ask())))) == len(loads) == 1 and not files._loading


def test_folders_must_be_packages_of_different_names(package, tmp_path):
    with pytest.raises(ConfigError, match=r"nothing.*expected a package"):
        PackageFiles([tmp_path / "nothing"])
    (tmp_path / "frames").mkdir()
    assert list(PackageFiles([package, tmp_path / "frames"]).packages) == ["two.airgs"]
    (tmp_path / "frames" / "0.ply").touch()
    with pytest.raises(ConfigError, match=r"frames: expected a package.*, a folder with packages or an empty one"):
        PackageFiles([package, tmp_path / "frames"])
    other = shutil.copytree(package, tmp_path / "other" / "two.airgs")
    for second in (other, other.parent):
        with pytest.raises(ConfigError, match="twice"):
            PackageFiles([package, second])


def test_of_two_packages_of_one_name_the_one_that_was_named_first_is_served(package, tmp_path):
    shelves = [tmp_path / "a", tmp_path / "b"]
    for shelf, name in zip(shelves, ("x", "y"), strict=True):
        shutil.copytree(package, shelf / name)
    files = PackageFiles([*shelves, package])
    for name in ("x", "y", "two.airgs"):
        for shelf in shelves:
            shutil.copytree(package, shelf / name, dirs_exist_ok=True)
    expected = {"two.airgs": package, "x": shelves[0] / "x", "y": shelves[0] / "y"}
    assert files.packages == expected
