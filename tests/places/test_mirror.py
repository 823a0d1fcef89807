"""Sequences below an address of an object store: what is fetched, how much of it stays, and what is said of errors."""

import json
import multiprocessing
import pickle
import shutil
from collections import Counter

import numpy as np
import pytest

from airgs_codec.errors import ConfigError, SceneError, TransportError
from airgs_codec.places import mirror
from airgs_codec.places.place import Bucket, bucket_at
from airgs_codec.scene.beside import Usage, save_usage
from airgs_codec.scene.sequence import open_sequence
from tests.support.clip_files import random_rows, splatv_bytes
from tests.support.paths import FOX
from tests.support.scenes import moving_frames, random_gaussians, write_sequence
from tests.support.servers import put_folder
from tests.support.splat_files import splat_bytes, write_sog_folder


@pytest.fixture
def place(bucket, request):
    """An address with nothing below it."""
    return f"{bucket}/{request.node.name}/scene"


@pytest.fixture
def fetched(monkeypatch):
    """Times that each object was fetched whole; beginnings of objects count below the name of their format."""
    count = Counter()
    download, read_start = Bucket.download, Bucket.read_start
    monkeypatch.setattr(Bucket, "download", lambda s, path, to: count.update([path]) or download(s, path, to))
    monkeypatch.setattr(
        Bucket, "read_start", lambda s, path, length: count.update(["headers"]) or read_start(s, path, length)
    )
    return count


def expect_same(a, b):
    for name in a.__slots__:
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def room(sequence):
    """Bytes on the disk that the frames of a sequence take."""
    return sum(512 * path.stat().st_blocks for path in sequence.paths)


def test_a_frame_is_fetched_when_it_is_read(place, fetched, tmp_path):
    shutil.copytree(FOX, tmp_path / "fox")
    ones = np.ones(len(open_sequence(FOX).read(0)))
    save_usage(tmp_path / "fox" / "usage.npz", {(0, 5): Usage(ones, ones, ones.astype(np.int64), ones)})
    here, there = open_sequence(tmp_path / "fox"), open_sequence(put_folder(tmp_path / "fox", place))
    assert (there.fps, there.keyframes, there.headers) == (here.fps, here.keyframes, here.headers)
    assert [camera.name for camera in there.cameras] == [camera.name for camera in here.cameras]
    assert set(fetched) == {"headers", "sequence.json", "transforms.json"} and fetched["headers"] <= len(here) + 1
    assert room(there) < room(here) / 2
    expect_same(there.read(3), here.read(3))
    assert [path.name for path in here.paths if fetched[path.name]] == [here.paths[3].name]
    expect_same(there.usage(0, 5), here.usage(0, 5))
    assert there.usage(5, 10) is None and there.attribution == here.attribution != ""
    assert there.axes == here.axes


def test_a_header_longer_than_what_is_fetched_first_is_read(place, tmp_path):
    folder = write_sequence(tmp_path / "scene", moving_frames(20, 1))
    path = folder / "000000.ply"
    path.write_bytes(path.read_bytes().replace(b"element vertex", b"comment long\n" * 4000 + b"element vertex", 1))
    assert open_sequence(put_folder(folder, place)).headers == open_sequence(folder).headers


def test_frames_make_room_for_others(place, fetched, tmp_path, monkeypatch):
    frames = moving_frames(500, 6)
    here = open_sequence(write_sequence(tmp_path / "scene", frames, cameras=False))
    size = (tmp_path / "scene" / "000000.ply").stat().st_size
    monkeypatch.setattr(mirror.Mirror.__init__, "__kwdefaults__", {"deep": True, "limit": 2 * size})
    sequence = open_sequence(put_folder(tmp_path / "scene", place))
    opened = room(sequence)
    for number in (0, 1, 0, 2, 0):
        expect_same(sequence.read(number), frames[number])
        assert room(sequence) < opened + 3 * size
    assert (fetched["000000.ply"], fetched["000001.ply"], fetched["000002.ply"]) == (1, 1, 1)
    sequence.read(1)
    assert fetched["000001.ply"] == 2  # it was the one least recently used
    before = fetched.copy()
    loaded = sequence.load(range(6)).frames  # more than fit: they stay while they are read
    for one, other in zip(loaded, here.load(range(6)).frames, strict=True):
        expect_same(one, other)
    assert max((fetched - before).values()) == 1
    assert room(sequence) < 4 * size
    folder = sequence.folder
    del sequence
    assert not folder.exists()


def write_gltf(path, g):
    """A .gltf with its buffer beside it."""
    data = splat_bytes(g, ".glb")
    length = int.from_bytes(data[12:16], "little")
    document = json.loads(data[20 : 20 + length])
    document["buffers"][0]["uri"] = "a%20b.bin"
    path.write_text(json.dumps(document))
    (path.parent / "a b.bin").write_bytes(data[28 + length :])


@pytest.mark.parametrize("kind", [".compressed.ply", ".v3.spz", ".sog", ".splat", ".glb", "folder", ".gltf"])
def test_every_format_is_read_as_from_a_folder(place, tmp_path, kind):
    folder = tmp_path / "scene"
    folder.mkdir()
    for number in range(1 if kind == ".gltf" else 2):
        g = random_gaussians(40, seed=number)
        if kind == "folder":
            write_sog_folder(folder / f"frame{number}", g)
        elif kind == ".gltf":
            write_gltf(folder / "frame.gltf", g)
        else:
            (folder / f"frame{number}{kind}").write_bytes(splat_bytes(g, kind))
    here, there = open_sequence(folder), open_sequence(put_folder(folder, place))
    assert here.headers == there.headers and here.axes == there.axes
    for number in reversed(range(len(here))):
        expect_same(there.read(number), here.read(number))


def test_a_file_is_opened_by_its_own_name_with_the_cameras_beside_it(place, fetched, tmp_path):
    shutil.copy(FOX / "transforms.json", tmp_path)
    write_sequence(tmp_path, moving_frames(40, 2), cameras=False, fps=12)
    (tmp_path / "a.splatv").write_bytes(splatv_bytes(random_rows(50)))
    put_folder(tmp_path, place)
    frame, clip = open_sequence(f"{place}/000001.ply"), open_sequence(f"{place}/a.splatv", bake_fps=4, duration=1)
    assert (len(frame), frame.fps, len(frame.cameras)) == (1, 30, 20)
    assert (len(clip), len(clip.cameras)) == (4, 20) and fetched["a.splatv"] == 1
    expect_same(clip.read(3), open_sequence(tmp_path / "a.splatv", bake_fps=4, duration=1).read(3))
    assert fetched["a.splatv"] == 1 and not fetched["000000.ply"]


def test_an_inria_model_has_its_cameras(place, tmp_path):
    write_sequence(tmp_path / "point_cloud" / "iteration_7", moving_frames(30, 1), cameras=False)
    (tmp_path / "point_cloud" / "iteration_7" / "000000.ply").rename(
        tmp_path / "point_cloud" / "iteration_7" / "point_cloud.ply"
    )
    shutil.copy(FOX / "transforms.json", tmp_path)
    sequence = open_sequence(put_folder(tmp_path, place))
    assert len(sequence.cameras) == 20
    assert sequence.files.name_of(sequence.cameras_path) == f"{place}/transforms.json"


def test_errors_name_the_object_in_one_line(place, tmp_path):
    with pytest.raises(SceneError, match=f"^{place}: expected a prefix with frames below it, or a file, got nothing$"):
        open_sequence(place)
    with pytest.raises(TransportError, match=r"^s3://nowhere/x: .*bucket does not exist"):
        open_sequence("s3://nowhere/x")
    with pytest.raises(ConfigError, match="s3://, gs://, az://"):
        open_sequence("ftp://host/x")
    store = bucket_at(put_folder(write_sequence(tmp_path / "scene", moving_frames(300, 3), fps=12), place))
    sequence = open_sequence(place)
    store.delete(["000002.ply"])
    with pytest.raises(SceneError, match=f"^{place}/000002.ply: expected the object that was listed, got nothing$"):
        sequence.load(range(3))
    store.write("000001.ply", (tmp_path / "scene" / "000001.ply").read_bytes()[:2000])
    with pytest.raises(SceneError, match=f"^{place}/000001.ply: expected 300 vertex rows") as error:
        open_sequence(place).load(range(2))
    assert "\n" not in str(error.value)
    store.write("usage.npz", b"PK")
    with pytest.raises(SceneError, match=f"^{place}/usage.npz: expected usage"):
        open_sequence(place).usage(0, 2)
    store.write("sequence.json", b"{")
    with pytest.raises(SceneError, match=f"^{place}/sequence.json: expected"):
        open_sequence(place)
    store.delete(["000000.ply", "sequence.json"])
    store.write("000001.ply", b"no ply")
    with pytest.raises(SceneError, match=f"^{place}/000001.ply: expected a .ply header"):
        open_sequence(place)


def test_names_stay_inside_of_the_folder():
    sizes = {"a/../../x.ply": 1, "a": 0, "a/1.ply": 5, "b.ply": 2}
    assert mirror._as_files(sizes) == {"a/1.ply": 5, "b.ply": 2}


def read_packed(packed):
    """In another process: the positions of the last frame, the name of its file, and which mirror it is from."""
    sequence = pickle.loads(packed)
    return sequence.read(len(sequence) - 1).means, sequence.files.name_of(sequence.paths[-1]), id(sequence.files)


def test_a_sequence_is_read_in_another_process(place, tmp_path):
    write_sequence(tmp_path / "scene", moving_frames(40, 2))
    (tmp_path / "a.splatv").write_bytes(splatv_bytes(random_rows(50)))
    put_folder(tmp_path, place)
    places = [tmp_path / "scene", tmp_path / "a.splatv", f"{place}/scene", f"{place}/a.splatv"]
    sequences = [open_sequence(where) for where in places]
    expected = [sequence.read(len(sequence) - 1).means for sequence in sequences]
    packed = [pickle.dumps(sequence) for sequence in (*sequences, sequences[2])]
    assert max(map(len, packed)) < 3000
    del sequences  # and with them the folders that objects were fetched to
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        found = pool.map(read_packed, packed)
    assert found[4][2] == found[2][2] != found[3][2]  # one mirror for all copies of a sequence
    for (means, name, _), other, where in zip(found, expected, places, strict=False):
        np.testing.assert_array_equal(means, other)
        assert name.startswith(str(where))
