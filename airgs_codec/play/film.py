"""What the viewer saw: the rungs of a session decoded, rendered on a walk, and filmed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from airgs_codec.decoder.decode import decode_canonical, decode_segment
from airgs_codec.decoder.sound import decode_all
from airgs_codec.media.image import label, to_bytes
from airgs_codec.media.movie import write_movie
from airgs_codec.media.mp4 import SOUND_RATE
from airgs_codec.package.package import Package
from airgs_codec.package.region import levelled, place_view, view_from
from airgs_codec.package.tables import Region
from airgs_codec.play.session import SessionLog
from airgs_codec.progress import Progress, silent
from airgs_codec.render import Camera
from airgs_codec.render.backend import CPU, Renderer
from airgs_codec.scene.camera import resized
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.sequence import GaussianSequence

LONGER_SIDE = 640  # pixels of a picture, at most
STEP_S = 2.0  # of a walk, from a place to the next
CIRCLE_REACHES, CIRCLE_STOPS = 0.5, 8  # about a single place: radius in reaches, and stops


def walk(log: SessionLog) -> list[Camera]:
    """Return the camera of every display tick, on a walk through the package's viewing region."""
    m = log.offers.manifest
    views = walk_through(levelled(m.region, m.world), np.arange(len(log.screen_ticks)) / log.offers.fps)
    return [resized(view, LONGER_SIDE / max(view.width, view.height)) for view in views]


def walk_through(region: Region, times: NDArray[np.float64]) -> list[Camera]:
    """Return the camera of a walking viewer at each of (T,) times in seconds.

    The walk leads from each place of the region to the nearest one left and back, again and again; about a single place
    in a circle. It turns about what the viewer looks at, and so never passes through it.
    """
    tour, left = [region.places[0]], list(region.places[1:])
    while left:
        last = np.array([*tour[-1].position, *tour[-1].focus])
        tour.append(left.pop(int(np.argmin([np.linalg.norm(last - [*p.position, *p.focus]) for p in left]))))
    stops = [*tour, *tour[-2::-1]]
    if len(tour) == 1:
        right, down = place_view(region, tour[0]).world_to_camera[:2, :3] * CIRCLE_REACHES * tour[0].reach
        turns = 2 * np.pi * np.arange(CIRCLE_STOPS + 1) / CIRCLE_STOPS
        ring = tour[0].position + np.cos(turns)[:, None] * right + np.sin(turns)[:, None] * down
        stops = [replace(tour[0], position=position.tolist()) for position in ring]
    whole, share = np.divmod(times / STEP_S % (len(stops) - 1), 1)
    at, numbers = whole + share**2 * (3 - 2 * share), np.arange(len(stops))  # slower near the stops
    positions, foci, ups = (np.array([getattr(stop, of) for stop in stops]) for of in ("position", "focus", "up"))
    axes = [place_view(region, stop).world_to_camera[:3, :3] for stop in stops]
    ups /= np.linalg.norm(ups, axis=1, keepdims=True)
    rows = np.column_stack([foci, ups, np.linalg.norm(positions - foci, axis=1)])
    between = np.column_stack([np.interp(at, numbers, column) for column in rows.T])
    ahead = Slerp(numbers, Rotation.from_matrix(axes))(at).as_matrix()[:, 2]
    views = zip(between[:, :3] - between[:, 6:] * ahead, between[:, :3], between[:, 3:6], strict=True)
    return [view_from(region, *view, f"walk{i:04d}") for i, view in enumerate(views)]


def screen_frames(package: Package, log: SessionLog) -> Iterator[tuple[Gaussians | None, int]]:
    """Yield (Gaussians, entry of `log.shown`) for every display tick; each segment is decoded when it comes up.

    In a lost segment the last Gaussians stay; None before the first that could be shown.
    """
    m, decoded_at, frames = package.manifest, -1, list[Gaussians]()
    last: Gaussians | None = None
    for entry, frame in log.screen_ticks:
        s = log.shown[entry]
        if s.rung is not None:
            if entry != decoded_at:
                decoded_at, (quality, level) = entry, log.offers.rungs[s.rung]
                base = decode_canonical(package, m.group_of(s.segment), quality, m.levels[level].tiers)
                frames = list(decode_segment(package, s.segment, base, level, range(s.frames)))
            last = frames[frame]
        yield last, entry


def film(
    package: Package,
    log: SessionLog,
    path: Path,
    original: GaussianSequence | None = None,
    progress: Progress = silent,
    renderer: Renderer = CPU,
) -> None:
    """Write an H.264 film of the session: what the viewer saw, with rung, quality and waiting; right of it the same
    moment of the original, if there is one. Sound is silent during stalls. Raises CodecError.
    """
    offers, ticks, cameras = log.offers, log.screen_ticks, walk(log)

    def draw(gaussians: Gaussians | None, camera: Camera) -> NDArray[np.uint8]:
        black = np.zeros((camera.height, camera.width, 3), np.uint8)
        return black if gaussians is None else to_bytes(renderer.render(gaussians, camera).rgb)

    def pictures() -> Iterator[NDArray[np.uint8]]:
        for tick, (gaussians, entry) in enumerate(screen_frames(package, log)):
            progress("rendering the screen", tick, len(ticks))
            s, frame, camera = log.shown[entry], ticks[tick][1], cameras[tick]
            words = "lost" if s.rung is None else offers.names[s.rung]
            picture = label(draw(gaussians, camera), words + ("" if s.psnr is None else f"  {s.psnr:.1f} dB"))
            if tick and ticks[tick] == ticks[tick - 1]:
                picture = label(picture, "waiting for data", 1)
            if original is not None:
                given = original.read(offers.manifest.segments[s.segment].start + frame)
                picture = np.concatenate([picture, label(draw(given, camera), "original")], axis=1)
            yield picture

    write_movie(path, pictures(), offers.manifest.fps, sound_of(package, log))


def sound_of(package: Package, log: SessionLog) -> NDArray[np.int16] | None:
    """Return (n, C) samples at 48 kHz as heard during the display ticks of a session; None without sound."""
    m = package.manifest
    numbers = [m.group_of(shown.segment) for shown in log.shown]
    groups = range(min(numbers), max(numbers) + 1)
    samples = decode_all(package, groups)
    if samples is None:
        return None
    first = m.groups.places.entry(groups.start).start
    frames = [log.offers.span(log.shown[entry].segment)[0] + frame - first for entry, frame in log.screen_ticks]
    ends = [round(tick / m.fps * SOUND_RATE) for tick in range(len(frames) + 1)]
    heard = np.zeros((ends[-1], samples.shape[1]), np.int16)
    first_tick = 0  # since which frames follow one another
    for tick, frame in enumerate(frames):
        if tick and frame == frames[tick - 1]:
            first_tick = tick + 1
            continue
        if tick and frame != frames[tick - 1] + 1:
            first_tick = tick
        at = round(frames[first_tick] / m.fps * SOUND_RATE) - ends[first_tick]
        part = samples[at + ends[tick] : at + ends[tick + 1]]
        heard[ends[tick] : ends[tick] + len(part)] = part
    return heard
