"""Comparing pictures: two sources of them, looked at in the same views."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache, lru_cache
from typing import TypeVar

from airgs_codec._settings import available_cores
from airgs_codec.errors import ConfigError
from airgs_codec.media.metrics import Picture
from airgs_codec.render.backend import CPU, Renderer
from airgs_codec.scene.camera import Camera
from airgs_codec.scene.gaussians import Gaussians

View = tuple[int, Camera]  # number of a frame, and what looks at it
Source = Callable[[int, Camera], Picture]  # shows a frame as a camera sees it
Measure = TypeVar("Measure")

MEASURED_AHEAD = 4  # views that are measured while the next one is drawn


def compare(
    reference: Source, shown: Source, views: Sequence[View], measure: Callable[[Picture, Picture], Measure]
) -> Iterator[Measure]:
    """Return what `measure` says of every view in turn, given the picture of the reference and the one that is shown.

    `measure` is `Picture.mse`, which is the cheapest, or `Difference.of` for every figure; `media.metrics.pool` makes
    one figure of many views. Each source is asked for a picture of a view when its turn comes; threads measure the
    last few views meanwhile, whose pictures stay in memory as long. Raises ConfigError without a view, and for pictures
    of different sizes.
    """
    if not views:
        raise ConfigError("views: expected at least one to compare pictures in, got none")
    return _measure_ahead((_drawn(view, reference, shown) for view in views), measure)


def _measure_ahead(
    pictures: Iterator[tuple[Picture, Picture]], measure: Callable[[Picture, Picture], Measure]
) -> Iterator[Measure]:
    begun: deque[Future[Measure]] = deque()
    with ThreadPoolExecutor(available_cores()) as threads:
        for pair in pictures:
            begun.append(threads.submit(measure, *pair))
            if len(begun) > MEASURED_AHEAD:
                yield begun.popleft().result()
        yield from (future.result() for future in begun)


def _drawn(view: View, reference: Source, shown: Source) -> tuple[Picture, Picture]:
    a, b = reference(*view), shown(*view)
    if a.rgb.shape != b.rgb.shape:
        (height, width), (found_height, found_width) = a.rgb.shape[:2], b.rgb.shape[:2]
        where = f"frame {view[0]}, camera {view[1].name}"
        raise ConfigError(f"{where}: expected {width}x{height} pixels, got {found_width}x{found_height}")
    return a, b


def draw_frames(read: Callable[[int], Gaussians], renderer: Renderer = CPU) -> Source:
    """Return the source of pictures of what `read` gives; the last frame stays loaded for its further views."""
    loaded = lru_cache(maxsize=1)(lambda frame: renderer.load(read(frame)))
    return lambda frame, camera: Picture.of(loaded(frame).draw(camera).rgb)


def in_order(numbers: Sequence[int], frames: Iterator[Gaussians]) -> Callable[[int], Gaussians]:
    """Return what reads frames of these ascending numbers from a stream of them; they are asked for in that order."""
    pairs = zip(numbers, frames, strict=True)
    return lambda number: next(frame for found, frame in pairs if found == number)


def draw_still(gaussians: Gaussians, renderer: Renderer = CPU) -> Source:
    """Return the source of pictures that show the same Gaussians in every frame."""
    loaded = renderer.load(gaussians)
    return lambda _, camera: Picture.of(loaded.draw(camera).rgb)


def draw_once(source: Source) -> Source:
    """Return a source that remembers its pictures: for a reference that several sources are compared with."""
    return cache(source)
