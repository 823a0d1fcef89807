"""A multi-view video: which camera saw which picture at each frame. Its pictures are read by `pictures`.

P points. Cameras are `scene.camera.Camera`: OpenCV convention, x right, y down, z forward, pixel centres at +0.5;
lengths are in the units of the scene.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cache, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError
from airgs_codec.media.image import Lens, check_picture, read_picture, to_bytes
from airgs_codec.media.movie import VideoReader
from airgs_codec.scene.camera import BLACK, Background, Camera, at_scale, cameras_from, rig_scale
from airgs_codec.scene.cameras.forms import Posed
from airgs_codec.scene.frames import MOVED, ZERO, Origin, rounded_middle
from airgs_codec.scene.sequence import GaussianSequence

if TYPE_CHECKING:
    from airgs_codec.render.backend import Loaded, Renderer

FrameRange = tuple[int, int | None]  # [start, stop); None: the last one, too
HELD_OUT_SHARE = 8  # one camera in this number is held out where a scene names none


@dataclass(frozen=True, slots=True)
class Source:
    path: Path
    frame: int | None = None  # its number in a video; None: the file is the picture

    def read(self, size: tuple[int, int]) -> NDArray[np.uint8]:
        """Read the picture, (H, W, 3) RGB or (H, W, 4) with alpha, of a `size` (width, height). Raises SceneError."""
        if self.frame is None:
            return read_picture(self.path, size)
        self.check(size)
        return open_video(self.path).read(self.frame)

    def check(self, size: tuple[int, int]) -> None:
        if self.frame is None:
            check_picture(self.path, size)
        else:
            open_video(self.path).check(size)

    def __str__(self) -> str:
        return str(self.path) if self.frame is None else f"{self.path} frame {self.frame}"


@cache
def open_video(path: Path) -> VideoReader:
    """Return the one decoder of a video. Raises SceneError."""
    return VideoReader(path)


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    camera: Camera  # of the undistorted picture at full size
    source: Source | DrawnSource
    lens: Lens | None = None  # None: the picture is that of a pinhole camera already
    mask: Path | None = None  # picture that is not 0 where the foreground is
    after: float = 0.0  # frames that it was taken after the time of its frame, less than 1

    @property
    def size(self) -> tuple[int, int]:
        return self.lens.size if self.lens else (self.camera.width, self.camera.height)


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    positions: NDArray[np.floating]  # (P, 3) world units
    colours: NDArray[np.float32] | None  # (P, 3) RGB, 0..1; None: not known


@dataclass(frozen=True, slots=True, eq=False)
class MultiviewScene:
    path: Path
    fps: Fraction  # frames a second
    frames: tuple[tuple[Shot, ...], ...]  # the shots of each frame; a camera whose picture is missing has none
    points: Points | None = None  # of the first frame; None: the scene has none
    background: Background = BLACK  # what its pictures show behind the scene
    given: GaussianSequence | None = None  # what its pictures are drawn from, where they are (`drawn_scene`)
    offsets: Mapping[str, float] = field(default_factory=dict)  # frames that cameras were late, of `sync.in_step`
    notes: tuple[str, ...] = ()  # what was changed or guessed when it was opened, in sentences
    origin: Origin = ZERO  # in the world, of the coordinates of cameras and points

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def cameras(self) -> list[Camera]:
        return [shot.camera for shot in self.frames[0]]

    def place(self, frame: int, camera: int) -> int | None:
        """Return where a camera, counted as in frame 0, is among the shots of a frame; None: it has no picture."""
        name = self.frames[0][camera].camera.name
        return next((i for i, shot in enumerate(self.frames[frame]) if shot.camera.name == name), None)


def in_frames(posed: Sequence[Posed], shot: Callable[[Posed], Shot]) -> tuple[tuple[Shot, ...], ...]:
    frames: dict[float, list[Shot]] = {time: [] for time in sorted({p.time for p in posed})}
    for p in posed:
        frames[p.time].append(shot(p))
    return tuple(map(tuple, frames.values()))


def frames_of(scene: MultiviewScene, span: FrameRange) -> tuple[int, int]:
    """Return the frames [A, B) of a scene; None: its end. Raises SceneError where it does not have them."""
    start, stop = span[0], len(scene) if span[1] is None else span[1]
    if not 0 <= start < stop <= len(scene):
        raise SceneError(f"{scene.path}: expected frames inside 0:{len(scene)}, got {start}:{stop}")
    return start, stop


def from_own_origin(scene: MultiviewScene) -> MultiviewScene:
    """Move a scene to an origin at which float32 is fine enough (MOVED), with near planes by what its cameras see."""
    places = scene.points.positions if scene.points else np.stack([camera.position for camera in scene.cameras])
    origin = rounded_middle(places)
    cameras = cameras_from(origin, scene.cameras)
    pixel = rig_scale(cameras, None) / max(camera.fx for camera in cameras)
    if np.spacing(np.float32(np.abs(origin).max())) / 2 > MOVED * pixel:
        shifted = scene.points and replace(scene.points, positions=scene.points.positions - origin)
        scene = _with_cameras(replace(scene, points=shifted, origin=origin), lambda c: cameras_from(origin, [c])[0])
    points = scene.points and replace(scene.points, positions=scene.points.positions.astype(np.float32))
    scale = rig_scale(scene.cameras, points.positions if points else None)
    return _with_cameras(replace(scene, points=points), lambda camera: at_scale([camera], scale)[0])


def with_near(scene: MultiviewScene, near: float) -> MultiviewScene:
    """Return the scene whose cameras draw no Gaussian nearer than `near` world units."""
    return _with_cameras(scene, lambda camera: replace(camera, near=near))


def with_held_out(scene: MultiviewScene, names: Sequence[str] | None) -> MultiviewScene:
    """Return the scene with the cameras `names` held out for testing.

    None: the cameras that the scene marks itself, or one in HELD_OUT_SHARE where it marks none. Raises SceneError for a
    name that no camera has, or when no camera remains to train on.
    """
    known = [camera.name for camera in scene.cameras]
    if names is None:
        if any(camera.held_out for camera in scene.cameras):
            return scene
        count = len(known) // HELD_OUT_SHARE  # the middles of equal parts: cameras between others, not at an end
        names = [known[(2 * i + 1) * len(known) // (2 * count)] for i in range(count)]
    if unknown := sorted(set(names) - set(known)):
        raise SceneError(f"{scene.path}: no camera {', '.join(unknown)}; there are {', '.join(known)}")
    held_out = set(names)
    if not set(known) - held_out:
        raise SceneError(f"{scene.path}: expected cameras to train on, all {len(known)} are held out")
    return _with_cameras(scene, lambda camera: replace(camera, split="test" if camera.name in held_out else "train"))


def _with_cameras(scene: MultiviewScene, change: Callable[[Camera], Camera]) -> MultiviewScene:
    frames = tuple(tuple(replace(shot, camera=change(shot.camera)) for shot in shots) for shots in scene.frames)
    return replace(scene, frames=frames)


def with_frames(scene: MultiviewScene, frames: Iterable[int]) -> MultiviewScene:
    """Return the scene without the pictures of all other frames, which retain their numbers."""
    wanted = set(frames)
    return replace(scene, frames=tuple(s if i in wanted else () for i, s in enumerate(scene.frames)))


def without_masks(scene: MultiviewScene) -> MultiviewScene:
    return replace(scene, frames=tuple(tuple(replace(s, mask=None) for s in shots) for shots in scene.frames))


@lru_cache(maxsize=1)  # the last one stays loaded for its further views
def _loaded(sequence: GaussianSequence, frame: int, renderer: Renderer) -> Loaded:
    return renderer.load(sequence.load([frame]).frames[0])


@dataclass(frozen=True, slots=True)
class DrawnSource:
    frame: int
    camera: Camera
    sequence: GaussianSequence
    renderer: Renderer
    path: None = None  # it is in no file

    def read(self, size: tuple[int, int]) -> NDArray[np.uint8]:
        return to_bytes(_loaded(self.sequence, self.frame, self.renderer).draw(self.camera).rgb)

    def check(self, size: tuple[int, int]) -> None:
        """Accept any: the picture has the size of its camera."""

    def __str__(self) -> str:
        return f"{self.sequence.paths[self.frame]} frame {self.frame}"


def drawn_scene(sequence: GaussianSequence, cameras: Sequence[Camera], renderer: Renderer) -> MultiviewScene:
    frames = [[Shot(c, DrawnSource(i, c, sequence, renderer)) for c in cameras] for i in range(len(sequence))]
    known = tuple(map(tuple, frames)), None, sequence.background, sequence
    return MultiviewScene(sequence.folder, sequence.fps, *known, origin=sequence.origin)
