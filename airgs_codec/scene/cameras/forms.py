"""Cameras with their pictures as JSON files, .splatv and poses_bounds.npy have them: what tells a form, what reads it.

- nerfstudio's transforms.json: OpenGL camera-to-world matrices, one entry for each picture; sizes in pixels. What all
  entries share, but for the matrix, may be next to `frames`. Pictures, masks and points may lie anywhere: an absolute
  path is taken as it is, and another may leave the folder. Our own fields of an entry are `camera`, a name that is the
  same at all times, `time_index` or `time`, `near` in world units, and `split`, "test" for a held-out camera;
  nerfstudio's own lists `test_filenames` and `val_filenames` mark held-out pictures, too.
- INRIA's cameras.json, as gaussian-splatting (Kerbl et al. 2023) writes it with its models: a list of {id, img_name,
  width, height, position, rotation, fx, fy}. The rotation is camera-to-world in OpenCV's axes, the principal point is
  the middle of the picture, held-out cameras are not marked.
- splaTV's .splatv: the magic 0x674b and the length of a JSON header, both 32 bits, the header, then the Gaussians. The
  header is a list of chunks; one of type "splat" has `cameras` as cameras.json has them. The usual converter writes one
  and the same camera into every file, and the viewer passes it on: that one says nothing of the scene.
- CMU Panoptic as Dynamic 3D Gaussians has it (Luiten et al. 2024): train_meta.json, and test_meta.json for held-out.
  `fn`, `k`, `w2c` and `cam_id` are lists over frames of lists over cameras: a file under ims/, a (3, 3) matrix, an
  OpenCV world-to-camera matrix and the number of the camera; `w` and `h` are the size of every picture.
- LLFF's poses_bounds.npy: a row for each picture, or as N3DV has it for each camera's video, in the order of names. A
  row has 17 numbers: a 3 x 5 matrix (axes down, right, backwards; position; height, width, focal length in pixels), and
  the nearest and farthest depth.
"""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError
from airgs_codec.media.image import Lens, fit_lens
from airgs_codec.scene.camera import OPENGL_TO_OPENCV, Camera, check_camera, rigid
from airgs_codec.scene.files import open_splatv, read_json, read_object

TRANSFORMS, INRIA_CAMERAS, LLFF = "transforms.json", "cameras.json", "poses_bounds.npy"
PANOPTIC, PANOPTIC_TEST = "train_meta.json", "test_meta.json"
FISHEYE = "OPENCV_FISHEYE"
# Beginnings of models in transforms.json that no pinhole stands for.
NO_LENS = ("EQUIRECTANGULAR", "OMNIDIRECTIONAL", "VR180", "ORTHO", "FISHEYE624")
PLACEHOLDER = [-3.0089893469241797, -0.11086489695181866, -3.7527640949141428]  # splaTV's own, to the last bit
INRIA_NEAR = 0.2  # world units: its rasteriser draws nothing nearer (in_frustum in auxiliary.h), so none was fitted
MOST_WIDE = 1600  # pixels: wider pictures are trained on at this width by default, though the file has their full size
# Metres. The cameras hang in the wall of a dome: what lies nearer is the wall that others see, and their own housing.
PANOPTIC_NEAR = 0.8
MOST_LETTERS = 255  # of a name in any file system


def as_path(text: object) -> str:
    """Return a path as a file has it, with the separators of every system as "/"."""
    return str(text).replace("\\", "/")


@dataclass(frozen=True, slots=True, eq=False)
class Posed:
    """A camera as a file describes it, and its picture. Raises ValueError for neither a camera nor a path."""

    camera: Camera  # of the undistorted picture
    picture: str = ""  # path of the picture as the file has it; empty: it names none
    lens: Lens | None = None  # None: the picture is that of a pinhole camera already
    time: float = 0.0  # of the picture, in any unit: equal within a frame, ascending
    mask: str | None = None  # path of the picture's mask as the file has it
    fixed: bool = False  # the camera has one name at all times: its first pose counts

    def __post_init__(self) -> None:
        check_camera(self.camera)
        for path in filter(None, (self.picture, self.mask)):
            parts = Path(path).parts
            if not (Path(path).name and path.isprintable() and max(map(len, parts)) <= MOST_LETTERS):
                raise ValueError(f"{path!r} is no name of a picture")


def distinct(posed: Iterable[Posed]) -> list[Camera]:
    """Return the cameras in the order in which they first appear: fixed ones once a name, others once a sight."""
    found: dict[object, Camera] = {}
    for c, fixed in ((p.camera, p.fixed) for p in posed):
        sight = c.width, c.height, c.fx, c.fy, c.cx, c.cy, c.world_to_camera.tobytes()
        found.setdefault(c.name if fixed else sight, c)
    return list(found.values())


def undistorted(camera: Camera, coefficients: NDArray[np.float64], fisheye: bool = False) -> tuple[Camera, Lens | None]:
    """Return the camera of undistorted pictures and the lens that they are undistorted for; None for a pinhole camera.

    `camera` has the intrinsics of distorted pictures, `coefficients` are OpenCV's of the model. Raises ValueError.
    """
    if not fisheye and not coefficients.any():
        return camera, None
    check_camera(camera)
    if not np.isfinite(coefficients).all():
        raise ValueError(f"camera {camera.name} has a lens that is not finite")
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    try:
        lens = fit_lens((camera.width, camera.height), matrix, coefficients, fisheye)
    except ValueError as error:
        numbers = ", ".join(f"{number:g}" for number in (camera.fx, camera.fy, camera.cx, camera.cy, *coefficients))
        raise ValueError(f"camera {camera.name}: {error}, got {'fisheye ' * fisheye}{numbers}") from error
    (fx, _, cx), (_, fy, cy), _ = lens.pinhole
    return replace(camera, fx=float(fx), fy=float(fy), cx=float(cx), cy=float(cy)), lens


def lens_notes(posed: Iterable[Posed]) -> tuple[str, ...]:
    """Return what people should know of the lenses of cameras: a sentence, or none."""
    cut = {p.camera.name: p.camera for p in posed if p.lens and p.lens.cut}
    if not cut:
        return ()
    angle = min(np.degrees(2 * np.arctan(max(c.width / 2 / c.fx, c.height / 2 / c.fy))) for c in cut.values())
    left = f"the middle {angle:.0f} degrees of what they see are used, the rest is cut off"
    return (f"{len(cut)} cameras, such as {next(iter(cut))}, have wide or strongly bending lenses: {left}",)


_Entry = ChainMap[str, Any]  # of a picture in transforms.json, over what all share


def read_transforms(path: Path) -> Iterator[Posed]:
    data = read_object(path)
    entries = [ChainMap(entry, data) for entry in data["frames"]]
    held_out = {*map(as_path, [*data.get("test_filenames", ()), *data.get("val_filenames", ())])}
    yield from (_of_entry(name, e, held_out) for name, e in zip(_names(entries), entries, strict=True))


def _names(entries: Sequence[_Entry]) -> list[str]:
    """Return a name for each entry: its `camera`, else its picture's, or that of the picture's folder where several
    folders have pictures over time.
    """
    paths = [PurePosixPath(as_path(entry.get("file_path", ""))) for entry in entries]
    moving = len({_time(entry) for entry in entries}) > 1 and len({path.parent for path in paths}) > 1
    given = [path.parent.name if moving else path.stem for path in paths]
    return [str(entry.get("camera", given[i] or f"view{i:03d}")) for i, entry in enumerate(entries)]


def _of_entry(name: str, entry: _Entry, held_out: set[str]) -> Posed:
    picture = as_path(entry.get("file_path", ""))
    to_world = np.asarray(entry.maps[0]["transform_matrix"], np.float64).reshape(4, 4)
    width, height, fx, fy, cx, cy = (float(entry[key]) for key in ("w", "h", "fl_x", "fl_y", "cx", "cy"))
    to_camera: NDArray[Any] = np.linalg.inv(to_world @ OPENGL_TO_OPENCV)
    split, near = str(entry.get("split", "test" if picture in held_out else "train")), float(entry.get("near", 0))
    if near <= 0 and "near" in entry:
        raise ValueError(f"near: expected a distance above 0, got {near:g}")
    taken = Camera(name, int(width), int(height), fx, fy, cx, cy, to_camera, split, near)
    camera, lens = _without_lens(taken, entry)
    mask = as_path(entry["mask_path"]) if "mask_path" in entry else None
    return Posed(camera, picture, lens, _time(entry), mask, "camera" in entry)


def _without_lens(camera: Camera, entry: _Entry) -> tuple[Camera, Lens | None]:
    model = str(entry.get("camera_model", "OPENCV")).upper()
    if model.startswith(NO_LENS):
        raise ValueError(f"camera {camera.name} has camera_model {model}, which is no perspective")
    if model != FISHEYE and float(entry.get("k4", 0)):
        raise ValueError(f"camera {camera.name} has k4 of {entry['k4']}, which no lens model of OpenCV's has")
    names = ("k1", "k2", "k3", "k4") if model == FISHEYE else ("k1", "k2", "p1", "p2", "k3")
    coefficients = np.array([float(entry.get(name, 0)) for name in names])
    return undistorted(camera, coefficients, fisheye=model == FISHEYE)


def _time(entry: _Entry) -> float:
    return float(entry["time_index"] if "time_index" in entry else entry.get("time", 0))


def read_inria(path: Path) -> Iterator[Posed]:
    yield from _inria_cameras(read_json(path))


def read_splatv(path: Path) -> Iterator[Posed]:
    cameras = [camera for chunk in open_splatv(path)[1] for camera in chunk.get("cameras", ())]
    if cameras and all(camera["position"] == PLACEHOLDER for camera in cameras):
        raise SceneError(f"{path}: expected cameras of this scene, got the one that splaTV writes into every file")
    yield from _inria_cameras(cameras)


def _inria_cameras(data: Any) -> Iterator[Posed]:
    for number, entry in enumerate(data):
        picture = as_path(entry.get("img_name", f"view{number:03d}"))
        width, height = int(entry["width"]), int(entry["height"])
        shown = min(width, MOST_WIDE)
        tall = int(height * shown / width)  # cut off, not rounded
        to_world = rigid(np.asarray(entry["rotation"], np.float64).reshape(3, 3), entry["position"])
        lens = float(entry["fx"]) * shown / width, float(entry["fy"]) * tall / height, shown / 2, tall / 2
        to_camera: NDArray[Any] = np.linalg.inv(to_world)
        yield Posed(Camera(picture, shown, tall, *lens, to_camera, near=INRIA_NEAR), picture)


def read_panoptic(path: Path) -> Iterator[Posed]:
    """Yield cameras frame by frame; those of a test_meta.json next to the file follow, held out."""
    test = path.with_name(PANOPTIC_TEST)
    for name in dict.fromkeys((path, test) if test.is_file() else (path,)):
        data = read_object(name)
        size, split = (int(data["w"]), int(data["h"])), "test" if name == test else "train"
        if not all(map(len, data["fn"])):
            raise ValueError("a frame has no pictures")
        for time, moment in enumerate(zip(data["fn"], data["k"], data["w2c"], data["cam_id"], strict=True)):
            for file, k, w2c, number in zip(*moment, strict=True):
                if not file:
                    raise ValueError("a picture without a name")
                m, view = np.asarray(k, np.float64).reshape(3, 3), np.asarray(w2c, np.float64).reshape(4, 4)
                lens = m[0, 0], m[1, 1], m[0, 2], m[1, 2]
                camera = Camera(f"cam{number:02d}", *size, *lens, view, split, PANOPTIC_NEAR)
                yield Posed(camera, as_path(file), time=time, fixed=True)


def read_llff(path: Path) -> Iterator[Posed]:
    rows = np.asarray(np.load(path, allow_pickle=False)).astype(np.float64).reshape(-1, 17)
    for number, row in enumerate(rows):
        pose = row[:15].reshape(3, 5)
        height, width, focal = pose[:, 4]
        axes = np.stack([pose[:, 1], pose[:, 0], -pose[:, 2]])  # the rows are down, right and backwards
        view = rigid(axes, -axes @ pose[:, 3])
        middle = width / 2, height / 2
        yield Posed(Camera(f"view{number:03d}", int(width), int(height), focal, focal, *middle, view))
