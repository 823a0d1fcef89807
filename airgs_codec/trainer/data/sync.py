"""Cameras that are not in step: how many frames later than the others each one shows the same moment, and a scene in
whose frames all cameras show the same moment.

The offset is found from the pictures alone, for cameras that stand still. Whatever moves lies in one plane with the
places of two cameras, and both see that plane at the same angle around the line between them, however far away it is:
what moves, summed over bins of that angle, is the same signal in both but for the time between them. Pairs of cameras
tell how well their signals agree for each lag, and the offsets of all cameras are those that agree best in all pairs
together.

An offset is positive where a camera is late. T frames, B bins, L lags, in quarters of a frame.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from itertools import dropwhile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree

from airgs_codec.errors import SceneError
from airgs_codec.progress import Progress, silent
from airgs_codec.scene.camera import Camera
from airgs_codec.scene.files import expecting, read_object
from airgs_codec.trainer.data.multiview import MultiviewScene, Shot, frames_of
from airgs_codec.trainer.data.pictures import Pictures, stands_still
from airgs_codec.trainer.fit.points import neighbours

REACH = 5  # frames that a camera may be early or late
STEPS = 4  # offsets are found in so many parts of a frame
LAGS = np.arange(-2 * REACH * STEPS, 2 * REACH * STEPS + 1)
FEWEST, MOST = 12, 120  # frames that tell it
SIDE = 240  # pixels, the longest side of the pictures that are compared
BINS = 96  # of the angle around the line between two cameras
LEAST_ANGLE = 0.05  # radians that both must see
NEIGHBOURS = 8  # cameras that each one is compared with
STRONGEST = 30  # of 255: more motion counts as much
OVERLAP, LEAST_OVERLAP = 0.4, 6  # share, and frames, that two signals must have in common
# Measured with shifted cameras of `multiview/basketball`: 0.75 to 1 of the pairs agree, and 0.2 where nothing moves.
AGREE = 0.5  # frames between the best lag of a pair and that of the solution
AGREED = 0.6  # share of all pairs that must agree, and half of those of a camera
LEAST = 0.5  # frames: what is less is in step
DEVIATIONS = 3.0  # by which the offset of a camera must be better than none, over its pairs
LEAST_DEVIATION = 0.01  # of a correlation
WHOLE = 1e-3  # frames: an offset that is as near to a whole number is one

Pair = tuple[int, int]
Curves = Mapping[
    Pair, NDArray[np.float64]
]  # (L,) correlation of two cameras for each lag; NaN: they overlap too little


def find_offsets(
    scene: MultiviewScene, span: tuple[int, int | None] = (0, None), progress: Progress = silent
) -> dict[str, float]:
    """The offsets of a scene's cameras against their median, at most about REACH frames, in quarters of a frame.

    `span`: the frames [A, B) that are wanted; those around them tell it as well, where they are few.

    Only cameras that are not in step have one, positive where they are late. A camera has none where its offset is
    less than half a frame, or is not sure: where too few of its pairs agree, or it is hardly better than none. Nothing
    is found, and no picture read, of cameras that move, of fewer than three, or of fewer than FEWEST frames.

    Raises SceneError for a picture that cannot be read.
    """
    names = [camera.name for camera in scene.cameras]
    frames = around(scene, span)
    if len(frames) < FEWEST or len(names) < 3 or not stands_still(scene):
        return {}
    curves = compare(scene, frames, progress)
    solution = solve(curves, len(names))
    agreed = [_agrees(curve, int(solution[b] - solution[a])) for (a, b), curve in curves.items()]
    if sum(agreed) < max(1, AGREED * len(agreed)):
        return {}
    return {name: float(solution[c]) / STEPS for c, name in enumerate(names) if _is_out_of_step(curves, solution, c)}


def around(scene: MultiviewScene, span: tuple[int, int | None]) -> range:
    start, stop = frames_of(scene, span)
    first = max(0, start - REACH)
    return range(first, min(len(scene), max(stop, start + 2 * FEWEST) + REACH, first + MOST))


def compare(scene: MultiviewScene, frames: range, progress: Progress = silent) -> Curves:
    """The correlation of neighbouring cameras for each lag. Raises SceneError for a picture that cannot be read."""
    pictures = Pictures(scene, max_size=SIDE, picture_bytes=1, target_bytes=1)
    cameras = pictures.cameras()
    bins: list[dict[Pair, NDArray[np.intp]]] = [{} for _ in cameras]
    for a, b in neighbours(cameras, NEIGHBOURS):
        if shared := _shared_bins(cameras[a], cameras[b]):
            bins[a][a, b], bins[b][a, b] = shared
    signals = []
    for index, seen in enumerate(bins):
        signals.append(_signals(pictures, index, frames, seen) if seen else {})
        progress("looking for cameras out of step", index + 1, len(cameras))
    pairs = sorted({pair for found in signals for pair in found})
    return {(a, b): correlate(signals[a][a, b], signals[b][a, b]) for a, b in pairs}


def _shared_bins(a: Camera, b: Camera) -> tuple[NDArray[np.intp], NDArray[np.intp]] | None:
    """(H * W,) bins of pixels' angles around the line between two cameras, BINS where the other sees none; or None."""
    line = b.position - a.position
    if not (length := np.linalg.norm(line)):
        return None
    line = line / length
    ahead = a.world_to_camera[2, :3] + b.world_to_camera[2, :3]
    ahead = ahead - line * (ahead @ line)
    if not (length := np.linalg.norm(ahead)):
        return None
    across = np.cross(line, ahead / length)
    angles = [np.arctan2(rays @ across, rays @ (ahead / length)) for rays in (_rays(a), _rays(b))]
    low, high = max(angle.min() for angle in angles), min(angle.max() for angle in angles)
    if high - low < LEAST_ANGLE:
        return None
    first, second = (np.floor((angle - low) / (high - low) * BINS).astype(np.intp) for angle in angles)
    return tuple(np.where((bins >= 0) & (bins < BINS), bins, BINS) for bins in (first, second))  # type: ignore[return-value]


def _rays(camera: Camera) -> NDArray[np.float64]:
    x = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    y = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    u, v = np.meshgrid(x, y)
    return np.stack([u, v, np.ones_like(u)], axis=-1).reshape(-1, 3) @ camera.world_to_camera[:3, :3]


def _signals(
    pictures: Pictures, index: int, frames: range, bins: Mapping[Pair, NDArray[np.intp]]
) -> dict[Pair, NDArray[np.float64]]:
    """(T - 1, B) for each pair of a camera: mean motion of the pixels in each bin, from each frame to the next."""
    sizes = {pair: np.maximum(np.bincount(places, minlength=BINS + 1)[:BINS], 1) for pair, places in bins.items()}
    out = {pair: np.zeros((len(frames) - 1, BINS)) for pair in bins}
    before = None
    for place, frame in enumerate(frames):
        view = pictures.seen_by(index, frame)
        grey = 255 * view.target.rgb.mean(axis=2).ravel() if view else None  # what moved around a hole is not known
        if before is not None and grey is not None:
            motion = np.abs(grey - before)
            motion = np.clip(motion - 3 * np.median(motion) / 0.6745, 0, STRONGEST)  # a camera's noise is no motion
            moving = np.flatnonzero(motion)
            for pair, places in bins.items():
                out[pair][place - 1] = np.bincount(places[moving], motion[moving], BINS + 1)[:BINS] / sizes[pair]
        before = grey
    return out


def correlate(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """(L,) correlation of two signals (T, B) for each lag by which the second is late; NaN where they overlap too
    little. Bins are weighed alike but for those in which little ever moves.
    """
    count = len(first)
    fine = np.arange(STEPS * (count - 1) + 1) / STEPS
    a, b = (CubicSpline(np.arange(count), _levelled(signal))(fine) for signal in (first, second))
    fewest = STEPS * max(LEAST_OVERLAP, OVERLAP * count)
    out = np.full(len(LAGS), np.nan)
    for place, lag in enumerate(LAGS.tolist()):
        if len(fine) - abs(lag) >= fewest:
            p, q = a[max(0, -lag) : len(a) - max(0, lag)], b[max(0, lag) : len(b) - max(0, -lag)]
            p, q = p - p.mean(axis=0), q - q.mean(axis=0)
            out[place] = (p * q).sum() / np.sqrt((p * p).sum() * (q * q).sum() + 1e-12)
    return out


def _levelled(signal: NDArray[np.float64]) -> NDArray[np.float64]:
    deviation = signal.std(axis=0)
    return signal / (deviation + 0.5 * np.sqrt(np.mean(deviation**2)) + 1e-9)


def solve(curves: Curves, count: int) -> NDArray[np.intp]:
    """(count,) offsets of cameras in quarters of a frame, at which their pairs correlate best; the lower median is 0.

    Each camera in turn takes the offset that is best for its pairs until none does any more, from all in step, and from
    the offsets along the strongest pairs that connect them. A pair counts as much as it can correlate at all.
    """
    weighed = {pair: np.nan_to_num(curve * max(np.nanmax(curve), 0), nan=-1.0) for pair, curve in curves.items()}
    of: list[list[tuple[int, NDArray[np.float64]]]] = [[] for _ in range(count)]
    for (a, b), curve in weighed.items():
        of[a].append((b, curve[::-1]))
        of[b].append((a, curve))
    grid, middle = np.arange(-REACH * STEPS, REACH * STEPS + 1), len(LAGS) // 2

    def settle(offsets: NDArray[np.intp]) -> NDArray[np.intp]:
        for _ in range(100):
            before = offsets.copy()
            for camera, pairs in enumerate(of):
                if pairs:
                    offsets[camera] = grid[sum(curve[middle + grid - offsets[o]] for o, curve in pairs).argmax()]
            if np.array_equal(before, offsets):
                break
        return offsets

    found = [settle(start) for start in (np.zeros(count, np.intp), _along_the_strongest(weighed, count))]
    best = max(found, key=lambda o: sum(c[middle + o[b] - o[a]] for (a, b), c in weighed.items()))
    return best - np.sort(best)[(count - 1) // 2]


def _along_the_strongest(weighed: Curves, count: int) -> NDArray[np.intp]:
    lags = {pair: int(LAGS[curve.argmax()]) for pair, curve in weighed.items()}
    lags |= {(b, a): -lag for (a, b), lag in lags.items()}
    places = np.array(list(weighed), np.intp).reshape(-1, 2).T
    costs = [2 - curve.max() for curve in weighed.values()]
    tree = minimum_spanning_tree(coo_array((costs, (places[0], places[1])), shape=(count, count)))
    offsets: NDArray[np.intp] = np.zeros(count, np.intp)
    order, before = breadth_first_order(tree, 0, directed=False)
    for camera in order[1:]:
        offsets[camera] = offsets[before[camera]] + lags[int(before[camera]), int(camera)]
    return np.clip(offsets - int(np.median(offsets)), -REACH * STEPS, REACH * STEPS)


def _is_out_of_step(curves: Curves, offsets: NDArray[np.intp], camera: int) -> bool:
    """Whether a camera is known to be out of step: its offset is large, its pairs agree on it and all gain by it."""
    gains, agreed = [], []
    for (a, b), curve in curves.items():
        if camera in (a, b):
            lag = int(offsets[b] - offsets[a])
            without = lag - int(offsets[camera]) * (1 if camera == b else -1)
            gains.append(_at(curve, lag) - _at(curve, without))
            agreed.append(_agrees(curve, lag))
    if len(gains) < 2 or abs(offsets[camera]) < LEAST * STEPS or float(np.mean(agreed)) < 0.5:
        return False
    deviation = max(float(np.std(gains, ddof=1)), LEAST_DEVIATION) / np.sqrt(len(gains))
    return bool(np.mean(gains) >= DEVIATIONS * deviation)


def _at(curve: NDArray[np.float64], lag: int) -> float:
    place = lag + len(LAGS) // 2
    return float(np.nan_to_num(curve[place])) if 0 <= place < len(LAGS) else 0.0


def _agrees(curve: NDArray[np.float64], lag: int) -> bool:
    return bool(abs(LAGS[np.nanargmax(curve)] - lag) <= AGREE * STEPS)


def in_step(
    scene: MultiviewScene, offsets: Mapping[str, float], span: tuple[int, int | None] = (0, None)
) -> MultiviewScene:
    """The frames [A, B) of a scene, in whose frame t each camera shows what it took nearest to t + its offset.

    An offset is in frames, positive where a camera is late, and 0 unless named. Frames that not all cameras have are
    left out, and as many behind them taken in, where they are there. Points are those of the first frame of the scene.

    Raises SceneError for frames that are not there, a name that no camera has, cameras that move, and offsets that
    leave no frame.
    """
    first, end = frames_of(scene, span)
    late = {name: offset for name, offset in offsets.items() if offset}
    names = [camera.name for camera in scene.cameras]
    if not late:
        found = scene.frames[first:end]
        if len(found[0]) < len(names) and stands_still(scene):
            raise SceneError(f"{scene.path}: expected pictures of all cameras at frame {first}, where training begins")
        return replace(scene, frames=found, points=None if first else scene.points)
    if unknown := sorted(set(late) - set(names)):
        raise SceneError(f"{scene.path}: no camera {', '.join(unknown)}; there are {', '.join(names)}")
    if not stands_still(scene):
        raise SceneError(f"{scene.path}: expected cameras that stand still, where they are not in step")
    of = [late.get(name, 0.0) for name in names]
    start = max(first, math.ceil(-min(of) - WHOLE))
    stop = min(start + end - first, math.floor(len(scene) - 1 - max(of) + WHOLE) + 1)
    shots = [[_shot_at(scene, i, frame + offset) for i, offset in enumerate(of)] for frame in range(start, stop)]
    frames = tuple(tuple(filter(None, of_frame)) for of_frame in dropwhile(lambda of_frame: None in of_frame, shots))
    if not frames:
        raise SceneError(f"{scene.path}: expected offsets that leave a frame of {end - first} to all cameras")
    return replace(scene, frames=frames, offsets=late, points=None if first else scene.points)


def _shot_at(scene: MultiviewScene, index: int, time: float) -> Shot | None:
    """What a camera took nearest to a time in frames; of two that are as near, the earlier one. None: it is missing."""
    nearest = math.ceil(time - 0.5 - WHOLE)
    after = round(nearest - time, 6)
    if (place := scene.place(nearest, index)) is None:
        return None
    shot = scene.frames[nearest][place]
    return replace(shot, after=after) if abs(after) > WHOLE else shot


def read_offsets(path: Path) -> dict[str, float]:
    """The offsets in a JSON file, an object of cameras' names and frames. Raises SceneError."""
    table = read_object(path)
    with expecting(path, "an object of cameras and by how many frames each is late"):
        for name, offset in table.items():
            if isinstance(offset, bool) or not isinstance(offset, (int, float)) or not math.isfinite(offset):
                raise ValueError(f"got {offset!r} for {name}")
    return {name: float(offset) for name, offset in table.items()}
