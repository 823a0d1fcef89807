"""Opening a multi-view scene: a reader for each format, and the table of them. T frames.

nerfstudio's transforms.json has an entry for each picture, or for each camera where entries name videos. CMU Panoptic,
as Dynamic 3D Gaussians has it, has masks in seg/ that are not 0 where something moves. COLMAP's sparse/ comes with
videos/CAM.mp4, images/CAM/* or one picture each. Scenes of HiFi4G and DualGS are image_white_undistortion/FRAME/CAM.png
before white and a reconstruction in colmap/sparse/0, in the folder of the frames as it is downloaded or next to it; its
images are named as the pictures of a frame are. A poses_bounds.npy has a row for each camera's video, in the order of
their names; of N3DV's, cam00 is held out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import partial
from pathlib import Path

import numpy as np

from airgs_codec.errors import SceneError
from airgs_codec.media.image import is_turned
from airgs_codec.places.place import is_address
from airgs_codec.scene.beside import DEFAULT_FPS, exact_number, frame_rate
from airgs_codec.scene.camera import with_pixels
from airgs_codec.scene.cameras import colmap, forms, read_posed
from airgs_codec.scene.cameras.forms import Posed, as_path
from airgs_codec.scene.files import Cursor, expecting, read_object
from airgs_codec.scene.formats.ply import read_points
from airgs_codec.scene.formats.table import has_frames, is_frame, natural_key
from airgs_codec.trainer.data.multiview import (
    FrameRange,
    MultiviewScene,
    Points,
    Shot,
    Source,
    frames_of,
    from_own_origin,
    in_frames,
    open_video,
)

CLOUDS = tuple(f"{name}.ply" for name in ("points3d", "points3D", "points_frame0", "points", "sparse_pc"))
POINT_FILES = (*CLOUDS, "points3d.npy", "init_pt_cld.npz")
VIDEO_SUFFIXES = (".mp4", ".mkv", ".mov", ".webm", ".avi")
PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".bmp")

Film = tuple[Shot, Path]  # a camera that stands still, and what it filmed: a video, or a folder of pictures by name


def read_transforms(folder: Path) -> MultiviewScene:
    """Read the scene of a transforms.json. Frames are the distinct `time_index`, or the distinct `time` without it.

    Without either, as `ns-process-data` writes it, all pictures are of one frame. `ply_file_path` names its points.
    Raises SceneError.
    """
    path = folder / forms.TRANSFORMS
    posed = read_posed(path)
    fps, points, name = _frame_rate(path), None, read_object(path).get("ply_file_path")
    if name is not None:
        with expecting(path, "the points of ply_file_path"):
            if not isinstance(name, str) or not (folder / as_path(name)).is_file():
                raise ValueError(f"got no file {name}")
        points = Points(*read_points(folder / as_path(name)))
    films = {p.camera.name: (_picture_shot(folder, p), folder / p.picture) for p in posed}
    if all(path.suffix.lower() in VIDEO_SUFFIXES for _, path in films.values()):
        return replace(scene_from_films(folder, list(films.values())), points=points)
    return MultiviewScene(folder, fps, in_frames(posed, partial(_picture_shot, folder)), points)


def _picture_shot(folder: Path, posed: Posed) -> Shot:
    picture = folder / posed.picture
    mask = folder / posed.mask if posed.mask else None
    return _shot(posed, picture if picture.suffix else picture.with_suffix(".png"), posed.camera.name, mask)


def read_panoptic(folder: Path) -> MultiviewScene:
    def shot(posed: Posed) -> Shot:
        mask = folder / "seg" / Path(posed.picture).with_suffix(".png")
        return _shot(posed, folder / "ims" / posed.picture, posed.camera.name, mask if mask.is_file() else None)

    path = folder / forms.PANOPTIC
    return MultiviewScene(folder, _frame_rate(path), in_frames(read_posed(path), shot))


def _frame_rate(path: Path) -> Fraction:
    with expecting(path, "a frame rate"):
        return frame_rate(str(path), exact_number(str(read_object(path).get("fps", DEFAULT_FPS))))


def scene_from_films(folder: Path, films: Sequence[Film]) -> MultiviewScene:
    """Return the scene of cameras that filmed videos, or folders of pictures. Raises SceneError for a mismatch."""
    if not any(path.is_dir() for _, path in films):
        return _joined_by_time(folder, films)
    sources = [[Source(path) for path in find_files(place, PICTURE_SUFFIXES)] for _, place in films]
    counts = sorted({len(pictures) for pictures in sources})
    if len(counts) > 1:
        raise SceneError(f"{folder}: expected as many frames of every camera, got {counts[0]} to {counts[-1]}")
    moments = zip(*sources, strict=True)
    frames = (tuple(replace(shot, source=s) for (shot, _), s in zip(films, m, strict=True)) for m in moments)
    return MultiviewScene(folder, DEFAULT_FPS, tuple(frames))


def _joined_by_time(folder: Path, films: Sequence[Film]) -> MultiviewScene:
    """Return the scene of videos while all cameras have pictures; where one dropped a frame it has no shot."""
    for shot, path in films:
        open_video(path).check(shot.size)
    clocks = [open_video(path).clock for _, path in films]
    rates = sorted({clock.fps for clock in clocks if clock.fps})
    drifts = [max(c.pictures) * (c.fps / rates[0] - 1) for c in clocks if c.fps and c.fps > 1.001 * rates[0]]
    if max(drifts, default=0) > 0.5:  # frames, at the end
        listed = ", ".join(f"{float(rate):g}" for rate in rates)
        raise SceneError(f"{folder}: expected videos of one frame rate, got {listed}")
    fps = frame_rate(str(folder), rates[0]) if rates else DEFAULT_FPS
    begin = min(clock.start_s for clock in clocks)
    late = [round((clock.start_s - begin) * fps) for clock in clocks]
    shown = [{at + frame: n for frame, n in c.pictures.items()} for at, c in zip(late, clocks, strict=True)]
    common = set.intersection(*map(set, shown))
    if not common:
        raise SceneError(f"{folder}: expected videos of one time, they begin up to {max(late)} frames apart")
    every = sorted(set().union(*shown))
    moments = [frame for frame in every if min(common) <= frame <= max(common)]
    taken = [(*film, of) for film, of in zip(films, shown, strict=True)]
    frames = (tuple(replace(s, source=Source(path, of[m])) for s, path, of in taken if m in of) for m in moments)
    cameras: dict[str, list[str]] = {}
    for (shot, _), clock, at, of in zip(films, clocks, late, shown, strict=True):
        dropped = sum(moment not in of for moment in moments)
        counts = {f"begins {float(at / fps):.3g} s late": at, f"{dropped} of {len(moments)} frames dropped": dropped}
        for remark in (*clock.remarks, *(words for words, count in counts.items() if count)):
            cameras.setdefault(remark, []).append(shot.camera.name)
    words = [f"{remark}: {shortened(names)}" for remark, names in cameras.items()]
    if cut := max(every) + 1 - len(moments):
        words.append(f"left out are {cut} of {max(every) + 1} frames, which no camera has, or at the ends not all have")
    note = f"{len(moments)} frames of {float(fps):g} a second, joined by time; {'; '.join(words)}"
    return MultiviewScene(folder, fps, tuple(frames), notes=(note,) if words else ())


def shortened(names: Sequence[str]) -> str:
    return ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")


def find_files(folder: Path, suffixes: Sequence[str]) -> list[Path]:
    """Return the files in a folder with some suffixes, by name; none where it does not exist."""
    paths = folder.iterdir() if folder.is_dir() else ()
    return sorted((path for path in paths if path.suffix.lower() in suffixes), key=natural_key)


def read_poses_bounds(folder: Path) -> MultiviewScene:
    path = folder / forms.LLFF
    videos = sorted(find_files(folder, VIDEO_SUFFIXES) + find_files(folder / "videos", VIDEO_SUFFIXES), key=natural_key)
    cameras, stems = [p.camera for p in read_posed(path)], [video.stem for video in videos]
    if len(cameras) != len(videos):
        raise SceneError(f"{path}: expected a row for each of {len(videos)} videos, got {len(cameras)}")
    if twice := sorted({stem for stem in stems if stems.count(stem) > 1}):
        raise SceneError(f"{folder}: expected one video for each camera, got several of {', '.join(twice)}")
    films = []
    for camera, video in zip(cameras, videos, strict=True):
        shrunk = with_pixels(camera, *open_video(video).size)  # the matrix may be of the videos in another size
        split = "test" if video.stem == "cam00" else "train"  # that of N3DV
        films.append((Shot(replace(shrunk, name=video.stem, split=split), Source(video)), video))
    return scene_from_films(folder, films)


def read_colmap(folder: Path) -> MultiviewScene:
    """Read the scene of a reconstruction; an image CAM.ext or CAM/any.ext belongs to the camera CAM.

    A camera's pictures over time are a video or a folder; where no camera has any, the scene is one frame of all
    images. Raises SceneError.
    """
    model = colmap.find_model(folder)
    assert model is not None  # by which the folder was recognised
    posed, points = colmap.read(model), read_points3d(model)
    shots: dict[str, Shot] = {}
    for image in posed:
        name = Path(image.picture).parent.name or Path(image.picture).stem
        shots.setdefault(name, _shot(image, folder / "images" / image.picture, name))
    films = {name: _film(folder, name) for name in shots}
    if not any(films.values()):
        frame = tuple(_shot(image, folder / "images" / image.picture, image.picture) for image in posed)
        return MultiviewScene(folder, DEFAULT_FPS, (frame,), points)
    if missing := [name for name, film in films.items() if film is None]:
        raise SceneError(f"{folder}: expected a video or a folder of frames of {', '.join(missing)}")
    scene = scene_from_films(folder, [(shots[name], film) for name, film in films.items() if film])
    return replace(scene, points=points)


def _shot(posed: Posed, picture: Path, name: str, mask: Path | None = None) -> Shot:
    return Shot(replace(posed.camera, name=name), Source(picture), posed.lens, mask)


def _film(folder: Path, name: str) -> Path | None:
    videos = (*find_files(folder / "videos", VIDEO_SUFFIXES), *find_files(folder, VIDEO_SUFFIXES))
    films = [video for video in videos if video.stem == name]
    places = (folder / "frames" / name, folder / "images" / name)
    return next(iter(films), None) or next((p for p in places if len(find_files(p, PICTURE_SUFFIXES)) > 1), None)


def read_points3d(model: Path) -> Points | None:
    """Read the cloud of points in the folder of a reconstruction; None where it has no file. Raises SceneError."""
    path = next((path for name in ("points3D.bin", "points3D.txt") if (path := model / name).is_file()), None)
    if path is None:
        return None
    with expecting(path, "points of a COLMAP reconstruction"):
        rows = _rows_of_binary(path) if path.suffix == ".bin" else _rows_of_text(path)
        table = np.array(list(rows), np.float64).reshape(-1, 6)
    return Points(table[:, :3], table[:, 3:].astype(np.float32) / np.float32(255))


def _rows_of_binary(path: Path) -> Iterator[tuple[float, ...]]:
    cursor = Cursor.open(path)
    for _ in range(*cursor.take("Q")):
        _, x, y, z, red, green, blue, _, track = cursor.take("Q3d3BdQ")
        cursor.skip(8 * track)  # bytes for each picture that saw the point
        yield x, y, z, red, green, blue


def _rows_of_text(path: Path) -> Iterator[tuple[float, ...]]:
    with path.open(encoding="utf-8-sig") as file:
        for line in file:
            if line.strip() and not line.startswith("#"):
                x, y, z, red, green, blue = map(float, line.split(maxsplit=7)[1:7])
                yield x, y, z, red, green, blue


HIFI4G = "image_white_undistortion"


def has_hifi4g(folder: Path) -> bool:
    return (folder / HIFI4G).is_dir() or (folder.name == HIFI4G and colmap.find_model(folder / "colmap") is not None)


def read_hifi4g(folder: Path) -> MultiviewScene:
    pictures = folder / HIFI4G if (folder / HIFI4G).is_dir() else folder
    model = colmap.find_model(folder / "colmap") or colmap.find_model(pictures / "colmap")
    if model is None:
        raise SceneError(f"{folder}: expected colmap/sparse in it or in {HIFI4G}/, got none")
    numbered = [path for path in pictures.iterdir() if path.is_dir() and path.name.isdecimal()]
    if not numbered:
        raise SceneError(f"{pictures}: expected numbered folders, one a frame, got none")
    posed = sorted(colmap.read(model), key=lambda image: natural_key(Path(image.picture)))
    names, frames = [Path(image.picture).stem for image in posed], []
    for path in sorted(numbered, key=natural_key):
        of = {picture.stem: picture for picture in find_files(path, PICTURE_SUFFIXES)}
        if missing := [name for name in names if name not in of]:
            raise SceneError(f"{path}: expected pictures of {len(names)} cameras, got none of {', '.join(missing[:8])}")
        frames.append(tuple(_shot(image, of[name], name) for image, name in zip(posed, names, strict=True)))
    return MultiviewScene(folder, DEFAULT_FPS, tuple(frames), read_points3d(model), (1.0, 1.0, 1.0))


def _has(name: str) -> Callable[[Path], bool]:
    return lambda folder: (folder / name).is_file()


FORMATS = (  # what a folder has, what recognises it and reads it; the first that recognises a folder reads it
    (forms.PANOPTIC, _has(forms.PANOPTIC), read_panoptic),
    (forms.TRANSFORMS, _has(forms.TRANSFORMS), read_transforms),
    ("image_white_undistortion/ (HiFi4G)", has_hifi4g, read_hifi4g),
    ("COLMAP's sparse/", lambda folder: colmap.find_model(folder) is not None, read_colmap),
    (forms.LLFF, _has(forms.LLFF), read_poses_bounds),
)


def _reader(folder: Path) -> Callable[[Path], MultiviewScene] | None:
    return next((read for _, recognise, read in FORMATS if recognise(folder)), None)


def is_multiview(folder: Path) -> bool:
    """Return whether a folder looks like multi-view video rather than a Gaussian sequence."""
    return folder.is_dir() and not has_frames(folder, apart_from=POINT_FILES) and _reader(folder) is not None


def has_gaussians(place: str | Path) -> bool:
    """Return whether a place has a file or frames of Gaussians, not multi-view pictures and a cloud of points."""
    path = Path(place)
    if not path.is_dir():
        return is_address(place) or path.is_file()
    frames = sum(is_frame(one) and one.name not in POINT_FILES for one in path.iterdir())
    return frames > 1 or (frames == 1 and _reader(path) is None)


def open_scene(folder: Path, *, fps: Fraction | None = None, frames: FrameRange = (0, None)) -> MultiviewScene:
    """Open the multi-view scene in a folder, or its frames [A, B), without reading pictures yet.

    `fps`: frames a second, instead of what the scene says. Raises SceneError when no format fits, or a file or frames
    are broken or missing.
    """
    if (read := _reader(folder)) is None:
        *others, last = [sign for sign, *_ in FORMATS]
        raise SceneError(f"{folder}: expected multi-view pictures with {', '.join(others)} or {last}")
    scene = read(folder)
    if (empty := next((number for number, shots in enumerate(scene.frames) if not shots), None)) is not None:
        raise SceneError(f"{folder}: expected pictures of frame {empty}, got none")
    start, stop = frames_of(scene, frames)
    points = scene.points or (_read_points(folder) if start == 0 else None)
    if turned := [s.camera.name for s in scene.frames[0] if isinstance(s.source, Source) and is_turned(s.source.path)]:
        note = f"pictures are taken as they are stored, not as their EXIF orientation has it: {shortened(turned)}"
        scene = replace(scene, notes=(*scene.notes, note))
    found = replace(scene, frames=scene.frames[start:stop], fps=fps or scene.fps, points=points)
    return from_own_origin(found)


def _read_points(folder: Path) -> Points | None:
    path = next((folder / name for name in POINT_FILES if (folder / name).is_file()), None)
    if path is None:
        return None
    if path.suffix == ".ply":
        return Points(*read_points(path))
    with expecting(path, "rows of x, y, z [, r, g, b]"), path.open("rb") as file:
        loaded = np.load(file, allow_pickle=False)
        table = (loaded if isinstance(loaded, np.ndarray) else loaded["data"]).astype(np.float64)
        if table.ndim != 2 or table.shape[1] < 3:
            raise ValueError(f"got an array of shape {table.shape}")
        return Points(table[:, :3], table[:, 3:6].astype(np.float32) if table.shape[1] >= 6 else None)
