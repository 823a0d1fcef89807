"""A film of a package along a camera path: nothing on it but the scene."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec.decoder.decode import decode_frames
from airgs_codec.decoder.sound import decode_all
from airgs_codec.errors import SceneError
from airgs_codec.media.image import to_bytes
from airgs_codec.media.movie import write_movie
from airgs_codec.media.mp4 import SOUND_RATE
from airgs_codec.package.manifest import Manifest
from airgs_codec.package.package import Package
from airgs_codec.package.region import levelled, upright, view_from
from airgs_codec.progress import Progress, silent
from airgs_codec.render.backend import CPU, Renderer
from airgs_codec.scene.camera import Camera
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.keyframes import CameraPath, read_camera_path

EARLY = 1e-6  # of a frame, by which rounding may make a moment too early


def open_path(path: Path, m: Manifest) -> CameraPath:
    """A camera path for a package, which says what is up, and the field of view, where the path does not.

    Raises SceneError.
    """
    return read_camera_path(path, upright(levelled(m.region, m.world)), m.region.fov_y)


def cameras_along(path: CameraPath, m: Manifest, size: tuple[int, int], times: NDArray[np.float64]) -> list[Camera]:
    """Cameras of `size`, width and height in pixels, at some seconds of a path. Raises SceneError."""
    cameras: list[Camera] = []
    for seconds, values in zip(times.tolist(), path.at(times), strict=True):
        position, focus, up = values[:9].reshape(3, 3)
        if not np.linalg.norm(focus - position) > 0:
            raise SceneError(f"the camera path looks nowhere after {seconds:.3f} s: it goes through what it looks at")
        lens = replace(m.region, width=size[0], height=size[1], fov_y=float(values[9]))
        cameras.append(view_from(lens, position, focus, up, f"path{len(cameras):04d}"))
    return cameras


def film_along(
    package: Package,
    path: CameraPath,
    file: Path,
    size: tuple[int, int],
    fps: Fraction | None = None,
    device: tuple[Renderer, Progress] = (CPU, silent),
) -> int:
    """Film the best rung from a camera path, from its first keyframe to its last, and give the number of pictures.

    The scene goes on at its own speed, with its sound, and begins again when it is over. A path of one keyframe films
    the scene once. `fps` is by default that of the package. Raises SceneError, FormatError and CodecError, and leaves
    no file then.
    """
    m = package.manifest
    rate = fps or m.fps
    seconds = path.duration or m.frames / float(m.fps)
    count = max(1, round(seconds * rate) + (path.duration > 0 and not path.loop))
    cameras = cameras_along(path, m, size, np.arange(count) / float(rate))
    shown = _frames(package, [int(i / rate * m.fps + EARLY) for i in range(count)])
    sound = decode_all(package)
    heard = None if sound is None else np.resize(sound, (round(count / rate * SOUND_RATE), sound.shape[1]))
    write_movie(file, _pictures(shown, cameras, *device), rate, heard)
    return count


def _frames(package: Package, numbers: list[int]) -> Iterator[Gaussians]:
    """Frames of a package that is played again and again, by ascending numbers that go on over its end."""
    ends = itertools.repeat(package.manifest.frames)
    played = enumerate(frame.gaussians for end in ends for frame in decode_frames(package, 0, end))
    at, gaussians = next(played)
    for number in numbers:
        while at < number:
            at, gaussians = next(played)
        yield gaussians


def _pictures(
    shown: Iterator[Gaussians], cameras: list[Camera], renderer: Renderer, progress: Progress
) -> Iterator[NDArray[np.uint8]]:
    for number, (gaussians, camera) in enumerate(zip(shown, cameras, strict=True)):
        progress("rendering the path", number, len(cameras))
        yield to_bytes(renderer.render(gaussians, camera).rgb)
