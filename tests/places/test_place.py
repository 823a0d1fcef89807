"""Every place answers alike: a folder, memory, a bucket; a web server is read."""

import pickle

import pytest

from tests.faces import ConfigError, Folder, FormatError, Memory, airgs_manifest, open_package, place_at
from tests.support.paths import VALID
from tests.support.servers import plainly_serving


@pytest.fixture(params=["folder", "memory", "bucket"])
def place(request, tmp_path):
    if request.param == "folder":
        return Folder(tmp_path / "new")
    if request.param == "memory":
        return Memory("memory")
    return place_at(f"{request.getfixturevalue('bucket')}/{request.node.name}")


def test_what_is_written_is_read_listed_replaced_and_deleted(place):
    place.write("a.bin", b"one")
    place.write("b/c/d.bin", b"other")
    place.write("a.bin", b"again")
    assert place.paths() == ["a.bin", "b/c/d.bin"] and place.sizes() == {"a.bin": 5, "b/c/d.bin": 5}
    size, read = place.open("b/c/d.bin")
    assert (size, read(), place.read("a.bin")) == (5, b"other", b"again")
    assert place.exists("a.bin") and not place.exists("b") and place.read("b/c") is None and place.open("x/y") is None
    place.delete(["a.bin"])
    assert place.paths() == ["b/c/d.bin"]


def test_a_place_is_opened_by_its_address_in_another_process(place):
    place.write("a.bin", b"one")
    again = pickle.loads(pickle.dumps(place))
    assert (again.name, again.read("a.bin")) == (place.name, b"one")


def test_no_link_below_a_folder_is_followed(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "a.bin").write_bytes(b"precious")
    place = Folder(tmp_path / "place")
    place.write("a.bin", b"own")
    (place.path / "down").symlink_to(tmp_path / "elsewhere")
    (place.path / "b.bin").symlink_to(tmp_path / "elsewhere" / "a.bin")
    for path in ("down/a.bin", "b.bin"):
        with pytest.raises(FormatError, match="unsafe_path"):
            place.open(path)
    with pytest.raises(FormatError, match="unsafe_path"):
        place.write("down/a.bin", b"mine")
    with pytest.raises(FormatError, match="unsafe_path"):
        place.delete(["down/a.bin"])
    place.write("b.bin", b"mine")
    assert (tmp_path / "elsewhere" / "a.bin").read_bytes() == b"precious" and place.read("b.bin") == b"mine"
    assert place.paths() == ["a.bin", "b.bin", "down"]


def test_a_package_is_read_from_a_web_server(capsys):
    with plainly_serving(VALID) as port:
        address = f"http://127.0.0.1:{port}/moving"
        there, here = open_package(address), open_package(VALID / "moving")
        for path in here.manifest.files():
            assert there.read(path) == here.read(path)
        assert airgs_manifest(["inspect", address]) == 0
        with pytest.raises(FormatError, match="expected a package"):
            open_package(f"{address}/nothing")
        assert airgs_manifest(["validate", address]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_addresses_are_told_from_folders():
    assert place_at("s3://bucket/scene").name == "s3://bucket/scene"
    assert place_at("out/scene.airgs").name == "out/scene.airgs"
    for address in ("ftp://host/scene", "http://host/scene"):
        with pytest.raises(ConfigError, match="s3://, gs://, az://"):
            place_at(address)
    with pytest.raises(ConfigError, match="s3:///scene"):
        place_at("s3:///scene")
