"""Scenes of strangers that promise more than their bytes hold: refused in one line, at the cost of the bytes there are.

Everything runs within one GiB beyond what the tests have taken, so that a promise that is believed is a MemoryError.
"""

import json
import os
import resource
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest

from airgs_codec.trainer.data.multiview import hash_files
from tests.faces import Pictures, SceneError, Usage, load_usage, open_scene, read_cameras, save_usage, write_png

UNIT = np.eye(4).ravel().tolist()
CAMERA = {"w": 8, "h": 8, "fl_x": 8, "fl_y": 8, "cx": 4, "cy": 4}


@pytest.fixture(autouse=True)
def little_memory():
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + (1 << 30), hard))
    yield
    resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def transforms(folder: Path, text: str = "", **entry: object) -> Path:
    """A scene of one entry, or of the text of a transforms.json."""
    frames = [{"transform_matrix": UNIT, "file_path": "a.png", **entry}]
    (folder / "transforms.json").write_text(text or json.dumps(CAMERA | {"frames": frames}))
    return folder


def npy(shape: str, kind: str = "<f8") -> bytes:
    """A header of so many numbers, and hardly any of them."""
    header = f"{{'descr':'{kind}','fortran_order':False,'shape':{shape},}}".ljust(117) + "\n"
    return b"\x93NUMPY\1\0" + struct.pack("<H", len(header)) + header.encode() + bytes(100)


def shared_matrix(folder):
    text = json.dumps(CAMERA | {"transform_matrix": UNIT})[:-1]
    return transforms(folder, f'{text}, "frames": [{"{}," * 20_000}{{}}]}}')


def product_of_fields_and_entries(folder):
    text = json.dumps(CAMERA | {f"k{i}": 0 for i in range(30_000)})[:-1]
    return transforms(folder, f'{text}, "frames": [{"{}," * 100_000}{{}}]}}')


def deep_json(folder):
    return transforms(folder, '{"frames":' + "[" * 500_000)


def pipe(folder):
    os.mkfifo(folder / "a.png")
    return transforms(folder)


def points_of_a_long_name(folder):
    return transforms(
        folder, json.dumps({"ply_file_path": "a" * 5000} | CAMERA | {"frames": [{"transform_matrix": UNIT}]})
    )


def points_promised(folder, header=None):
    (folder / "points3d.npy").write_bytes(header or npy(f"({10**12},3)"))
    return transforms(folder)


def points_without_bytes(folder):
    return points_promised(folder, npy(f"({10**12},3)", "|V0"))


def points_of_an_archive(folder):
    np.savez_compressed(folder / "points.npz", a=np.zeros(9))
    return points_promised(folder, (folder / "points.npz").read_bytes())


SCENES = [
    (shared_matrix, "no 'transform_matrix'"),
    (product_of_fields_and_entries, "no 'transform_matrix'"),
    (deep_json, "expected JSON: maximum recursion"),
    (pipe, "a.png: expected a picture: No such file"),
    (points_of_a_long_name, "expected the points of ply_file_path"),
    (points_promised, "expected rows of x, y, z"),
    (points_without_bytes, "expected rows of x, y, z"),
    (points_of_an_archive, "expected rows of x, y, z"),
]


@pytest.mark.parametrize(("make", "message"), SCENES, ids=lambda value: getattr(value, "__name__", ""))
def test_a_scene_that_promises_more_than_it_has_is_refused_in_one_line(tmp_path, make, message):
    folder = make(tmp_path)
    with pytest.raises(SceneError, match=message) as caught:
        Pictures(open_scene(folder)).check()
    assert "\n" not in str(caught.value)


FILES = [
    ("poses_bounds.npy", npy(f"({10**12},17)"), read_cameras, "expected rows of 17 numbers"),
    ("poses_bounds.npy", b"\x93NUMPY\2\0" + struct.pack("<I", 9001) + b"-" * 9000 + b"1", read_cameras, "17 numbers"),
    ("images.bin", struct.pack("<Q", 2**64 - 1), read_cameras, "cameras.bin: expected a COLMAP reconstruction"),
    ("cameras.json", b"[" * 500_000, read_cameras, "expected JSON"),
    ("cameras.json", b"[" + b"1" * 500_000 + b"]", read_cameras, "expected JSON"),
    ("a.splatv", struct.pack("<II", 0x674B, 500_000) + b"[" * 500_000, read_cameras, "expected a .splatv header"),
]


@pytest.mark.parametrize(("name", "data", "read", "message"), FILES)
def test_a_file_that_promises_more_than_it_has_is_refused_in_one_line(tmp_path, name, data, read, message):
    (tmp_path / name).write_bytes(data)
    (tmp_path / "cameras.bin").write_bytes(struct.pack("<Q", 2**64 - 1))
    with pytest.raises(SceneError, match=message) as caught:
        read(tmp_path / name)
    assert "\n" not in str(caught.value)


def test_usage_that_is_promised_is_refused(tmp_path):
    path = tmp_path / "usage.npz"
    with zipfile.ZipFile(path, "w") as archive:
        for name in ("total", "peak", "hits"):
            archive.writestr(f"0:1/{name}.npy", npy(f"({10**12},)"))
    with pytest.raises(SceneError, match="expected usage as the trainer writes it"):
        load_usage(path, 0, 1, 10)


def test_usage_of_more_rows_than_the_frames_have_is_not_unpacked(tmp_path, monkeypatch):
    path = tmp_path / "usage.npz"
    save_usage(path, {(0, 1): Usage(*np.zeros((3, 10_000)))})
    assert len(load_usage(path, 0, 1, 10_000).total) == 10_000
    monkeypatch.setattr(np.lib.format, "read_array", None)
    with pytest.raises(SceneError, match="expected usage as the trainer writes it: 10 rows of 8 bytes, got 80128"):
        load_usage(path, 0, 1, 10)


@pytest.mark.parametrize(
    ("name", "words"), [("a\0.png", "embedded null"), ("/dev/zero", "got a device"), ("no.png", "No such file")]
)
def test_what_is_hashed_is_a_file(name, words):
    with pytest.raises(SceneError, match=f"expected a picture or a video: .*{words}"):
        hash_files([Path(name)])


def test_pictures_may_lie_anywhere(tmp_path):
    """As nerfstudio has it: by absolute paths, and outside the folder."""
    for place in ("elsewhere", "scene"):
        (tmp_path / place).mkdir()
    write_png(tmp_path / "elsewhere" / "a.png", np.zeros((8, 8, 3), np.uint8))
    for name in ("../elsewhere/a.png", str(tmp_path / "elsewhere" / "a.png")):
        Pictures(open_scene(transforms(tmp_path / "scene", file_path=name))).check()
