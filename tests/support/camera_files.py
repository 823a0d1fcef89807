"""One rig as each form of cameras has it: writers, independent of the readers."""

from __future__ import annotations

import itertools
import json
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tests.faces import Camera, write_png
from tests.support.multiview_files import matrix_of, plain

PLACEHOLDER = [-3.0089893469241797, -0.11086489695181866, -3.7527640949141428]  # of the camera in every .splatv
Rig = Sequence[Camera]
Writer = Callable[[Path, Rig], Path]


def intrinsics_of(c: Camera) -> dict[str, float]:
    return {"w": c.width, "h": c.height, "fl_x": c.fx, "fl_y": c.fy, "cx": c.cx, "cy": c.cy}


def to_world(c: Camera) -> np.ndarray:
    return np.linalg.inv(c.world_to_camera)


def saved(path: Path, data: Any) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    if isinstance(data, bytes):
        path.write_bytes(data)
    else:
        path.write_text(json.dumps(data))
    return path


def write_transforms(folder: Path, rig: Rig) -> Path:
    entries = [
        {"camera": c.name, "split": c.split, "time_index": t, "transform_matrix": matrix_of(c), **intrinsics_of(c)}
        for t, c in itertools.product(range(2), rig)
    ]
    return saved(folder / "transforms.json", {"camera_model": "PINHOLE", "frames": entries})


def write_nerfstudio(folder: Path, rig: Rig) -> Path:
    """One picture for each camera, held-out ones in a list, as nerfstudio itself has it."""
    names = {c.name: f"images/{c.name}.png" for c in rig}
    entries = [{"file_path": names[c.name], "transform_matrix": matrix_of(c)} for c in rig]
    lists = {"test_filenames": [names[c.name] for c in rig if c.held_out]}
    return saved(folder / "transforms.json", {**intrinsics_of(rig[0]), **lists, "frames": entries})


def as_inria(rig: Rig) -> list[dict[str, Any]]:
    sizes = [{"width": c.width, "height": c.height, "fy": c.fy, "fx": c.fx} for c in rig]
    poses = [{"position": to_world(c)[:3, 3].tolist(), "rotation": to_world(c)[:3, :3].tolist()} for c in rig]
    return [{"id": i, "img_name": c.name, **sizes[i], **poses[i]} for i, c in enumerate(rig)]


def write_inria(folder: Path, rig: Rig) -> Path:
    return saved(folder / "cameras.json", as_inria(rig))


def write_splatv(folder: Path, rig: Rig) -> Path:
    chunk = {"type": "splat", "size": 65536, "texwidth": 4096, "texheight": 1, "cameras": as_inria(rig)}
    header = json.dumps([chunk]).encode()
    return saved(folder / "scene.splatv", struct.pack("<II", 0x674B, len(header)) + header + bytes(65536))


def _colmap_pose(c: Camera) -> list[float]:
    x, y, z, w = Rotation.from_matrix(c.world_to_camera[:3, :3]).as_quat()
    return [w, x, y, z, *c.world_to_camera[:3, 3]]


def _colmap_test(model: Path, rig: Rig) -> Path:
    (model / "test.txt").write_text("".join(f"{c.name}.png\n" for c in rig if c.held_out))
    return model


def write_colmap_text(folder: Path, rig: Rig) -> Path:
    """sparse/0 in text, images in another order than their names'; one has no points, an empty line."""
    model = folder / "sparse" / "0"
    model.mkdir(parents=True)
    cameras, images = ["# Camera list"], ["# Image list", "#   POINTS2D[] as (X, Y, POINT3D_ID)"]
    for i, c in reversed(list(enumerate(rig, start=1))):
        cameras.append(f"{i} PINHOLE {c.width} {c.height} {c.fx} {c.fy} {c.cx} {c.cy}")
        images.append(f"{i} {' '.join(map(repr, map(float, _colmap_pose(c))))} {i} {c.name}.png")
        images.append("" if i == 2 else "1.5 2.5 -1 3.5 4.5 -1")
    (model / "cameras.txt").write_text("\n".join(cameras) + "\n")
    (model / "images.txt").write_text("\n".join(images) + "\n")
    return _colmap_test(model, rig)


def write_colmap_binary(folder: Path, rig: Rig) -> Path:
    model = folder / "sparse" / "0"
    cameras = images = struct.pack("<Q", len(rig))
    for i, c in enumerate(rig, start=1):
        cameras += struct.pack("<IiQQ4d", i, 1, c.width, c.height, c.fx, c.fy, c.cx, c.cy)
        images += struct.pack("<I7dI", i, *_colmap_pose(c), i) + f"{c.name}.png".encode() + b"\0"
        images += struct.pack("<QddqddQ", 2, 1.5, 2.5, -1, 3.5, 4.5, 7)
    saved(model / "cameras.bin", cameras)
    saved(model / "images.bin", images)
    return _colmap_test(model, rig)


def write_panoptic_meta(folder: Path, rig: Rig) -> Path:
    """train_meta.json and test_meta.json of two frames; cameras are numbered in the order of the rig."""
    size = {"w": rig[0].width, "h": rig[0].height}
    for split in ("train", "test"):
        chosen = [(i, c) for i, c in enumerate(rig) if c.split == split]
        lenses = [[[c.fx, 0, c.cx], [0, c.fy, c.cy], [0, 0, 1]] for _, c in chosen]
        moment = {"fn": [f"{i}/0.png" for i, _ in chosen], "k": lenses, "cam_id": [i for i, _ in chosen]}
        moment["w2c"] = [c.world_to_camera.tolist() for _, c in chosen]
        if chosen:
            saved(folder / f"{split}_meta.json", size | {key: [row, row] for key, row in moment.items()})
    return folder / "train_meta.json"


def write_panoptic(folder: Path, rig: Rig) -> Path:
    """A scene of two frames as CMU Panoptic has it; the left half of each mask is 0."""
    names = [[f"{i}/{t:06d}.png" for i in range(len(rig))] for t in range(2)]
    picture, path = plain(200, (48, 48)), write_panoptic_meta(folder, rig)
    saved(path, json.loads(path.read_text()) | {"fn": names})
    for place, seen in (("ims", 1), ("seg", np.arange(48)[:, None] >= 24)):
        for name in names[0] + names[1]:
            (folder / place / name).parent.mkdir(parents=True, exist_ok=True)
            write_png(folder / place / name, (picture * seen).astype(np.uint8))
    return folder


def write_llff(folder: Path, rig: Rig) -> Path:
    rows = []
    for c in rig:
        right, down, forward, position = to_world(c)[:3].T
        pose = np.stack([down, right, -forward, position, [c.height, c.width, c.fx]], axis=1)
        rows.append([*pose.ravel(), 0.5, 20.0])
    np.save(folder / "poses_bounds.npy", np.array(rows))
    return folder / "poses_bounds.npy"


FORMS: dict[str, Writer] = {
    "transforms": write_transforms, "nerfstudio": write_nerfstudio, "inria": write_inria, "llff": write_llff,
    "colmap text": write_colmap_text, "colmap binary": write_colmap_binary, "panoptic": write_panoptic_meta,
    "splatv": write_splatv,
}  # fmt: skip

MARK_HELD_OUT = ("transforms", "nerfstudio", "colmap text", "colmap binary", "panoptic")
