"""What the viewer saw: the rungs of a session decoded, rendered from a path of cameras, and filmed."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec.decoder.decode import decode_canonical, decode_segment
from airgs_codec.decoder.sound import decode_all
from airgs_codec.errors import FormatError
from airgs_codec.media.image import label, to_bytes
from airgs_codec.media.movie import write_movie
from airgs_codec.media.mp4 import SOUND_RATE
from airgs_codec.package.package import Package
from airgs_codec.play.downloader import Shown
from airgs_codec.play.offers import Offers
from airgs_codec.play.report.map import Viewer
from airgs_codec.play.session import SessionLog
from airgs_codec.progress import Progress, silent
from airgs_codec.render import Camera
from airgs_codec.render.backend import CPU, Renderer
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.sequence import GaussianSequence


def screen_frames(package: Package, log: SessionLog) -> Iterator[tuple[Gaussians | None, int]]:
    """(Gaussians, entry of `log.shown`) for every display tick; each segment is decoded when it comes up.

    In a lost segment the last Gaussians stay; None before the first that could be shown.
    """
    decoded_at = -1
    frames: list[Gaussians] = []
    last: Gaussians | None = None
    for entry, frame in log.screen_ticks:
        s = log.shown[entry]
        if s.rung is not None:
            if entry != decoded_at:
                decoded_at, frames = entry, _segment(package, s.segment, log.offers.rungs[s.rung])
            last = frames[frame]
        yield last, entry


def _segment(package: Package, index: int, rung: tuple[int, int]) -> list[Gaussians]:
    m, (quality, level) = package.manifest, rung
    segment = m.segments[index]
    base = decode_canonical(package, m.group_of(index), quality, m.levels[level].tiers)
    return list(decode_segment(package, index, base, level, range(segment.stop - segment.start)))


def _best(package: Package, c: Offers, segment: int) -> tuple[list[Gaussians], str]:
    """Frames of a segment at the first rung whose files are whole, and what to call it."""
    for name, rung in zip(c.names, c.rungs, strict=True):
        try:
            return _segment(package, segment, rung), f"best rung: {name}"
        except FormatError:
            continue
    return [], "no rung can be had"


def film(
    package: Package,
    log: SessionLog,
    viewer: Viewer,
    path: Path,
    original: GaussianSequence | None = None,
    progress: Progress = silent,
) -> None:
    """An H.264 film of the session: on the left what the viewer saw, with rung, quality, buffer and waiting, and by how
    much he was outside of the region; beside it the same moment of the original, or of the best rung where there is no
    `original`. It has the sound of the package; while the viewer waits, it is silent.

    Raises CodecError.
    """
    pictures = _pictures(package, log, viewer, original, progress)
    write_movie(path, pictures, log.offers.manifest.fps, sound_of(package, log))


def sound_of(package: Package, log: SessionLog) -> NDArray[np.int16] | None:
    """(n, C) samples, 48,000 a second, that were heard during the display ticks of a session; None without sound."""
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
    begun = 0  # the tick since when frames follow one another
    for tick, frame in enumerate(frames):
        if tick and frame == frames[tick - 1]:
            begun = tick + 1
            continue
        if tick and frame != frames[tick - 1] + 1:
            begun = tick
        at = round(frames[begun] / m.fps * SOUND_RATE) - ends[begun]
        part = samples[at + ends[tick] : at + ends[tick + 1]]
        heard[ends[tick] : ends[tick] + len(part)] = part
    return heard


def _pictures(
    package: Package,
    log: SessionLog,
    viewer: Viewer,
    original: GaussianSequence | None,
    progress: Progress,
) -> Iterator[NDArray[np.uint8]]:
    c, ticks, draw = log.offers, log.screen_ticks, viewer.renderer.render
    best: dict[int, tuple[list[Gaussians], str]] = {}
    beside: Gaussians | None
    seen = [0] * len(log.shown)
    at = log.shown[0].start_s
    for tick, (gaussians, entry) in enumerate(screen_frames(package, log)):
        progress("rendering the screen", tick, len(ticks))
        s, frame, camera = log.shown[entry], ticks[tick][1], viewer.cameras[tick]
        waits = seen[entry] == s.frames
        seen[entry] += not waits
        picture = _black(camera) if gaussians is None else to_bytes(draw(gaussians, camera).rgb)
        words = "lost" if s.rung is None else c.names[s.rung]
        picture = label(picture, words + ("" if s.psnr is None else f"  {s.psnr:.1f} dB"))
        for line, text in enumerate(filter(None, ["waiting for data" * waits, viewer.caption(tick)]), 1):
            picture = label(picture, text, line)
        picture = buffer_bar(picture, buffered_s(log, at), log.settings.buffer_s, waits)
        if original is not None:
            beside, name = original.read(c.manifest.segments[s.segment].start + frame), "original"
        else:
            if s.segment not in best:
                best = {s.segment: _best(package, c, s.segment)}
            frames, name = best[s.segment]
            beside = frames[frame] if frames else None
        shown = np.zeros_like(picture) if beside is None else to_bytes(draw(beside, camera).rgb)
        yield np.concatenate([picture, label(shown, name)], axis=1)
        at += 1 / c.fps


def buffered_s(log: SessionLog, at_s: float) -> float:
    """Seconds of media that have arrived and are not shown yet, at a moment."""
    fps = log.offers.fps
    arrived = sum(s.frames / fps for s in log.shown if s.ready_s <= at_s)
    played = sum(min(max(at_s - s.start_s, 0.0), s.frames / fps) for s in log.shown)
    return max(0.0, arrived - played)


def buffer_bar(picture: NDArray[np.uint8], seconds: float, limit: float, waits: bool) -> NDArray[np.uint8]:
    """(H, W, 3) with a bar along the lower edge: green as long as the buffer is full, red while the viewer waits."""
    out = picture.copy()
    height, width = picture.shape[:2]
    thick = max(4, height // 60)
    filled = round(width * min(1.0, seconds / limit))
    out[-thick:] = (150, 40, 30) if waits else (60, 60, 60)
    out[-thick:, :filled] = (70, 170, 95)
    return out


def still(package: Package, log: SessionLog, camera: Camera, renderer: Renderer = CPU) -> NDArray[np.uint8]:
    """(H, W, 3) the worst segment shown, as it was when it began: at the package's best rung, and as it was shown."""
    c = log.offers
    entries = [entry for entry, s in enumerate(log.shown) if s.rung is not None]
    if not entries:
        return label(_black(camera), "nothing could be shown")
    entry = min(entries, key=lambda e: _goodness(log.shown[e]))
    worst = log.shown[entry]
    shown = _segment(package, worst.segment, c.rungs[worst.rung or 0])[0]
    text = f"worst shown: {c.names[worst.rung or 0]}" + ("" if worst.psnr is None else f"  {worst.psnr:.1f} dB")
    frames, best = _best(package, c, worst.segment)
    beside = label(to_bytes(renderer.render(frames[0], camera).rgb) if frames else _black(camera), best)
    seen = to_bytes(renderer.render(shown, camera).rgb)
    return np.concatenate([beside, label(seen, text)], axis=1)


def _goodness(shown: Shown) -> float:
    """Quality in dB, or where it was not measured less for a later rung."""
    return shown.psnr if shown.psnr is not None else -(shown.rung or 0)


def _black(camera: Camera) -> NDArray[np.uint8]:
    return np.zeros((camera.height, camera.width, 3), np.uint8)
