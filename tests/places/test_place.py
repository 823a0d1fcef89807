"""Every place answers alike: a folder, memory, a bucket; a web server is read, object stores are copied."""

import multiprocessing
import pickle
import shutil

import numpy as np
import pytest

from airgs_codec.places import place as module
from tests import faces
from tests.faces import ConfigError, Folder, FormatError, SceneError, open_package, open_sequence, place_at
from tests.support.clip_files import random_rows, splatv_bytes
from tests.support.jobs import read_packed
from tests.support.paths import FOX, VALID
from tests.support.scenes import moving_frames, write_sequence
from tests.support.servers import plainly_serving, put_folder


@pytest.fixture(params=["folder", "memory", "bucket"])
def place(request, tmp_path):
    if request.param == "bucket":
        return place_at(f"{request.getfixturevalue('bucket')}/{request.node.name}")
    return Folder(tmp_path / "new") if request.param == "folder" else faces.Memory("memory")


def test_what_is_written_is_read_listed_replaced_and_deleted_and_opened_in_another_process(place):
    place.write("a.bin", b"one")
    place.write("b/c/d.bin", b"other")
    place.write("a.bin", b"again")
    assert place.paths() == ["a.bin", "b/c/d.bin"] and place.sizes() == {"a.bin": 5, "b/c/d.bin": 5}
    size, read = place.open("b/c/d.bin")
    assert (size, read(), place.read("a.bin")) == (5, b"other", b"again")
    assert place.open("b") is None and place.read("b/c") is None and place.open("x/y") is None
    sent = pickle.loads(pickle.dumps(place))
    assert (sent.name, sent.read("a.bin")) == (place.name, b"again")
    place.delete(["a.bin"])
    assert place.paths() == ["b/c/d.bin"]


def test_no_link_below_a_folder_is_followed(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "a.bin").write_bytes(b"precious")
    place = Folder(tmp_path / "place")
    place.write("a.bin", b"own")
    (place.path / "down").symlink_to(tmp_path / "elsewhere")
    (place.path / "b.bin").symlink_to(tmp_path / "elsewhere" / "a.bin")
    calls = (place.open, "b.bin"), *((do, "down/a.bin", *data) for do, *data in ((place.open,), (place.write, b"mine")))
    for follow, *given in (*calls, (place.delete, ["down/a.bin"])):
        with pytest.raises(FormatError, match="unsafe_path"):
            follow(*given)
    place.write("b.bin", b"mine")
    assert (tmp_path / "elsewhere" / "a.bin").read_bytes() == b"precious" and place.read("b.bin") == b"mine"
    assert place.paths() == ["a.bin", "b.bin", "down"]


def test_a_package_is_read_from_a_web_server_and_addresses_are_told_from_folders(capsys):
    with plainly_serving(VALID) as port:
        address = f"http://127.0.0.1:{port}/moving"
        there, here = open_package(address), open_package(VALID / "moving")
        assert all(there.read(path) == here.read(path) for path in here.manifest.files())
        assert faces.airgs_manifest(["inspect", address]) == 0
        with pytest.raises(FormatError, match="expected a package"):
            open_package(f"{address}/nothing")
        assert faces.airgs_manifest(["validate", address]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    for name in ("s3://bucket/scene", "out/scene.airgs"):
        assert place_at(name).name == name
    others = "s3://, gs://, az://"
    for address, says in (("ftp://host/scene", others), ("http://host/scene", others), ("s3:///scene", "s3:///scene")):
        with pytest.raises(ConfigError, match=says):
            place_at(address)


@pytest.fixture
def address(bucket, request):
    return f"{bucket}/{request.node.name}/scene"


def expect_same(a, b):
    for name in a.__slots__:
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def test_a_folder_is_read_as_from_this_machine(address):
    told = []
    here = open_sequence(FOX)
    there = open_sequence(put_folder(FOX, address), progress=lambda *words: told.append(words))
    assert (there.fps, there.keyframes, there.headers) == (here.fps, here.keyframes, here.headers)
    assert [camera.name for camera in there.cameras] == [camera.name for camera in here.cameras]
    assert there.attribution == here.attribution != "" and there.axes == here.axes
    expect_same(there.read(3), here.read(3))
    files = [path for path in FOX.rglob("*") if path.is_file()]
    size = sum(path.stat().st_size for path in files)
    assert told[0] == ("copying", 0, size) and told[-1] == ("copying", size, size)
    assert str(there.copied) == f"{address}: {len(files)} files, {size / 1e6:.3g} MB, copied here"
    assert there.name_of(there.cameras_path) == f"{address}/transforms.json"
    folder = there.folder
    del there
    assert not folder.parent.exists()


def test_a_file_is_opened_by_its_own_name_with_the_cameras_beside_it(address, tmp_path):
    shutil.copy(FOX / "transforms.json", tmp_path)
    write_sequence(tmp_path, moving_frames(40, 2), cameras=False, fps=12)
    (tmp_path / "a.splatv").write_bytes(splatv_bytes(random_rows(50)))
    put_folder(tmp_path, address)
    frame, clip = open_sequence(f"{address}/000001.ply"), open_sequence(f"{address}/a.splatv", bake_fps=4, duration=1)
    assert (len(frame), frame.fps, len(frame.cameras)) == (1, 30, 20)
    assert (len(clip), len(clip.cameras)) == (4, 20) and clip.copied.files == 2
    expect_same(clip.read(3), open_sequence(tmp_path / "a.splatv", bake_fps=4, duration=1).read(3))


def test_errors_name_the_object_in_one_line_and_names_stay_inside_of_the_folder(address, tmp_path, monkeypatch):
    def expect(error, says, where=address, read=lambda sequence: None):
        with pytest.raises(error, match=says) as caught:
            read(open_sequence(where))
        assert "\n" not in str(caught.value)

    expect(SceneError, f"^{address}: expected a prefix with frames below it, or a file, got nothing$")
    expect(faces.TransportError, r"^s3://nowhere/x: .*bucket does not exist", "s3://nowhere/x")
    expect(ConfigError, "s3://, gs://, az://", "ftp://host/x")
    scene = write_sequence(tmp_path / "scene", moving_frames(300, 3), fps=12)
    store = faces.bucket_at(put_folder(scene, address))
    store.write("000001.ply", (scene / "000001.ply").read_bytes()[:2000])
    short = f"^{address}/000001.ply: expected 300 vertex rows"
    expect(SceneError, short, read=lambda sequence: sequence.load(range(2)))
    expect(SceneError, short, f"{address}/000001.ply", lambda sequence: sequence.read(0))
    store.write("usage.npz", b"PK")
    expect(SceneError, f"^{address}/usage.npz: expected usage", read=lambda sequence: sequence.usage(0, 2))
    store.write("sequence.json", b"{")
    expect(SceneError, f"^{address}/sequence.json: expected")
    monkeypatch.setattr(module.shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(1, 1, 0))
    expect(ConfigError, f"expected 0.00 GB of room for {address}, got 0.00 GB")
    assert module._as_files({"a/../../x.ply": 1, "a": 0, "a/1.ply": 5, "b.ply": 2}) == {"a/1.ply": 5, "b.ply": 2}


@pytest.mark.parametrize("there", [True, False])
def test_a_sequence_is_read_in_another_process(address, tmp_path, there):
    """Of this machine, or of one that does not have the copies."""
    write_sequence(tmp_path / "scene", moving_frames(40, 2))
    (tmp_path / "a.splatv").write_bytes(splatv_bytes(random_rows(50)))
    put_folder(tmp_path, address)
    places = [f"{address}/scene", f"{address}/a.splatv"]
    sequences = [open_sequence(where) for where in places]
    expected = [sequence.read(len(sequence) - 1).means for sequence in sequences]
    packed = [pickle.dumps(sequence) for sequence in (*sequences, sequences[0])]
    assert max(map(len, packed)) < 3000
    if not there:
        del sequences
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        found = pool.map(read_packed, packed)
    assert found[2][2] == found[0][2] != found[1][2]  # one copy for all of a sequence
    for (means, name, _), other, where in zip(found, expected, places, strict=False):
        np.testing.assert_array_equal(means, other)
        assert name.startswith(where)
