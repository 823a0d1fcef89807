"""Sequences below an address of an object store, which are copied to this machine before they are read."""

import multiprocessing
import pickle
import shutil

import numpy as np
import pytest

from airgs_codec.places import place as module
from tests.faces import ConfigError, SceneError, TransportError, bucket_at, open_sequence
from tests.support.clip_files import random_rows, splatv_bytes
from tests.support.paths import FOX
from tests.support.scenes import moving_frames, write_sequence
from tests.support.servers import put_folder


@pytest.fixture
def place(bucket, request):
    return f"{bucket}/{request.node.name}/scene"


def expect_same(a, b):
    for name in a.__slots__:
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def test_a_folder_is_read_as_from_this_machine(place):
    told = []
    here = open_sequence(FOX)
    there = open_sequence(put_folder(FOX, place), progress=lambda *words: told.append(words))
    assert (there.fps, there.keyframes, there.headers) == (here.fps, here.keyframes, here.headers)
    assert [camera.name for camera in there.cameras] == [camera.name for camera in here.cameras]
    assert there.attribution == here.attribution != "" and there.axes == here.axes
    expect_same(there.read(3), here.read(3))
    files = [path for path in FOX.rglob("*") if path.is_file()]
    size = sum(path.stat().st_size for path in files)
    assert told[0] == ("copying", 0, size) and told[-1] == ("copying", size, size)
    assert str(there.copied) == f"{place}: {len(files)} files, {size / 1e6:.3g} MB, copied here"
    assert there.name_of(there.cameras_path) == f"{place}/transforms.json"
    folder = there.folder
    del there
    assert not folder.parent.exists()


def test_a_file_is_opened_by_its_own_name_with_the_cameras_beside_it(place, tmp_path):
    shutil.copy(FOX / "transforms.json", tmp_path)
    write_sequence(tmp_path, moving_frames(40, 2), cameras=False, fps=12)
    (tmp_path / "a.splatv").write_bytes(splatv_bytes(random_rows(50)))
    put_folder(tmp_path, place)
    frame, clip = open_sequence(f"{place}/000001.ply"), open_sequence(f"{place}/a.splatv", bake_fps=4, duration=1)
    assert (len(frame), frame.fps, len(frame.cameras)) == (1, 30, 20)
    assert (len(clip), len(clip.cameras)) == (4, 20) and clip.copied.files == 2
    expect_same(clip.read(3), open_sequence(tmp_path / "a.splatv", bake_fps=4, duration=1).read(3))


def test_errors_name_the_object_in_one_line(place, tmp_path, monkeypatch):
    with pytest.raises(SceneError, match=f"^{place}: expected a prefix with frames below it, or a file, got nothing$"):
        open_sequence(place)
    with pytest.raises(TransportError, match=r"^s3://nowhere/x: .*bucket does not exist"):
        open_sequence("s3://nowhere/x")
    with pytest.raises(ConfigError, match="s3://, gs://, az://"):
        open_sequence("ftp://host/x")
    store = bucket_at(put_folder(write_sequence(tmp_path / "scene", moving_frames(300, 3), fps=12), place))
    store.write("000001.ply", (tmp_path / "scene" / "000001.ply").read_bytes()[:2000])
    with pytest.raises(SceneError, match=f"^{place}/000001.ply: expected 300 vertex rows") as error:
        open_sequence(place).load(range(2))
    assert "\n" not in str(error.value)
    with pytest.raises(SceneError, match=f"^{place}/000001.ply: expected 300 vertex rows"):
        open_sequence(f"{place}/000001.ply").read(0)
    store.write("usage.npz", b"PK")
    with pytest.raises(SceneError, match=f"^{place}/usage.npz: expected usage"):
        open_sequence(place).usage(0, 2)
    store.write("sequence.json", b"{")
    with pytest.raises(SceneError, match=f"^{place}/sequence.json: expected"):
        open_sequence(place)
    monkeypatch.setattr(module.shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(1, 1, 0))
    with pytest.raises(ConfigError, match=f"expected 0.00 GB of room for {place}, got 0.00 GB"):
        open_sequence(place)


def test_names_stay_inside_of_the_folder():
    sizes = {"a/../../x.ply": 1, "a": 0, "a/1.ply": 5, "b.ply": 2}
    assert module._as_files(sizes) == {"a/1.ply": 5, "b.ply": 2}


def read_packed(packed):
    """In another process: the positions of the last frame, the name of its file, and which copy it is from."""
    sequence = pickle.loads(packed)
    return sequence.read(len(sequence) - 1).means, sequence.name_of(sequence.paths[-1]), id(sequence.copied)


@pytest.mark.parametrize("there", [True, False])
def test_a_sequence_is_read_in_another_process(place, tmp_path, there):
    """Of this machine, or of one that does not have the copies."""
    write_sequence(tmp_path / "scene", moving_frames(40, 2))
    (tmp_path / "a.splatv").write_bytes(splatv_bytes(random_rows(50)))
    put_folder(tmp_path, place)
    places = [f"{place}/scene", f"{place}/a.splatv"]
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
