"""What the viewer saw: the rungs of a session decoded, rendered from a path of cameras, and filmed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec.decode import decode_canonical, decode_segment
from airgs_codec.gaussians import Gaussians
from airgs_codec.package import Package
from airgs_codec.picture import label, to_bytes
from airgs_codec.play.session import SessionLog, screen_ticks
from airgs_codec.render import Camera, render
from airgs_codec.render.views import camera_path
from airgs_codec.video import write_movie

SECONDS_BETWEEN_CAMERAS = 4.0


def viewer_path(cameras: Sequence[Camera], ticks: int, fps: float) -> list[Camera]:
    """A camera a tick: back and forth through the given ones, SECONDS_BETWEEN_CAMERAS apart."""
    per_leg = max(2, round(SECONDS_BETWEEN_CAMERAS * fps))
    legs = -(-ticks // per_leg)
    there_and_back = [*range(len(cameras)), *range(len(cameras) - 2, 0, -1)]
    stops = [cameras[there_and_back[i % len(there_and_back)]] for i in range(legs + 1)]
    return camera_path(stops, legs * per_leg + 1)[:ticks]


def screen_frames(package: Package, log: SessionLog) -> Iterator[tuple[Gaussians, int]]:
    """(Gaussians, entry of `log.shown`) for every display tick; each segment is decoded when it comes up."""
    shown_at = -1
    frames: list[Gaussians] = []
    for entry, frame in screen_ticks(log):
        if entry != shown_at:
            shown_at = entry
            s = log.shown[entry]
            group = package.manifest.segments[s.segment].group
            base = decode_canonical(package, group, s.quality, log.manifest.levels[s.level].tiers)
            frames = list(decode_segment(package, s.segment, base, s.level, 0, s.frames))
        yield frames[frame], entry


def film(
    package: Package,
    log: SessionLog,
    cameras: Sequence[Camera],
    path: Path,
    progress: Callable[[str, int, int], None] = lambda what, done, total: None,
) -> None:
    """An H.264 film of the session, rung and stalls written on the picture. Raises CodecError."""
    fps = float(log.manifest.fps)
    ticks = len(screen_ticks(log))
    write_movie(path, _pictures(package, log, viewer_path(cameras, ticks, fps), progress), log.manifest.fps)


def _pictures(
    package: Package, log: SessionLog, path: list[Camera], progress: Callable[[str, int, int], None]
) -> Iterator[NDArray[np.uint8]]:
    m = log.manifest
    left = [s.frames for s in log.shown]
    for tick, (gaussians, entry) in enumerate(screen_frames(package, log)):
        progress("rendering the screen", tick, len(path))
        s = log.shown[entry]
        waits = left[entry] == 0
        left[entry] -= not waits
        text = f"{m.qualities[s.quality].id} + {m.levels[s.level].id}" + (
            "" if s.psnr is None else f"  {s.psnr:.1f} dB"
        )
        picture = label(to_bytes(render(gaussians, path[tick]).rgb), text)
        yield label(picture, "waiting for data", 1) if waits else picture


def still(package: Package, log: SessionLog, camera: Camera) -> NDArray[np.uint8]:
    """(H, W, 3) the first frame of the worst segment shown: at the package's best rung, and as it was shown."""
    m = log.manifest
    worst = min(log.shown, key=lambda s: s.psnr if s.psnr is not None else -s.level)
    pictures = []
    for what, quality, level in (("best", 0, 0), ("worst shown", worst.quality, worst.level)):
        segment = m.segments[worst.segment]
        base = decode_canonical(package, segment.group, quality, m.levels[level].tiers)
        gaussians = next(decode_segment(package, worst.segment, base, level, 0, 1))
        text = f"{what}: {m.qualities[quality].id} + {m.levels[level].id}"
        if segment.levels[level].psnr:
            text += f"  {segment.levels[level].psnr[quality]:.1f} dB"
        pictures.append(label(to_bytes(render(gaussians, camera).rgb), text))
    return np.concatenate(pictures, axis=1)
