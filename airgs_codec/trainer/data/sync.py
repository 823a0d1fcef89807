"""Cameras that are not synchronous: by how many frames each is late, and a scene in which all show the same moment.

The offset is found from the pictures alone, for cameras that stand still. Whatever moves lies in one plane with the
places of two cameras, and both see that plane at the same angle around their baseline, however far away it is: motion,
summed over bins of that angle, is the same signal in both but for the time between them. Signals of pairs of cameras
are correlated for each lag, and the offsets of all cameras are those that correlate best in all pairs together.

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
from airgs_codec.trainer.data.multiview import FrameRange, MultiviewScene, Shot, frames_of
from airgs_codec.trainer.data.pictures import ScenePictures, stands_still
from airgs_codec.trainer.fit.points import neighbours
from airgs_codec.trainer.settings import TrainSettings

REACH = 5  # frames that a camera may be early or late
PARTS_OF_FRAME = 4  # in which offsets are found
LAGS = np.arange(-2 * REACH * PARTS_OF_FRAME, 2 * REACH * PARTS_OF_FRAME + 1)
COMPARED_FRAMES = 12, 120  # fewest and most
BINS = 96  # of the angle around a baseline
WHOLE = 1e-3  # frames: an offset that is as near to a whole number is one

Pair = tuple[int, int]
Signals = dict[Pair, NDArray[np.float64]]  # (T - 1, B) for each pair of a camera
Curves = Mapping[Pair, NDArray[np.float64]]  # (L,) correlation of two cameras for each lag; NaN: too little overlap


def find_offsets(scene: MultiviewScene, span: FrameRange = (0, None), progress: Progress = silent) -> dict[str, float]:
    """Return the offsets of a scene's cameras against their median, at most about REACH frames, in quarters of a frame.

    `span`: the frames [A, B) that are wanted; where they are few, those around them are compared as well.

    Only cameras that are not synchronous have one. A camera has none where its offset is less than half a frame, too
    few of its pairs agree, or they gain too little by it; nor where cameras move, or are fewer than three, or have too
    few frames. Raises SceneError for a picture that cannot be read.
    """
    names, (start, stop), (fewest, most) = [c.name for c in scene.cameras], frames_of(scene, span), COMPARED_FRAMES
    first = max(0, start - REACH)
    frames = range(first, min(len(scene), max(stop, start + 2 * fewest) + REACH, first + most))
    if len(frames) < fewest or len(names) < 3 or not stands_still(scene):
        return {}
    curves = compare(scene, frames, progress)
    offsets = solve(curves, len(names))
    lags = {(a, b): int(offsets[b] - offsets[a]) for a, b in curves}
    agrees = {pair: abs(LAGS[np.nanargmax(c)] - lags[pair]) <= PARTS_OF_FRAME / 2 for pair, c in curves.items()}
    # Of pairs of shifted cameras of `multiview/basketball` 0.75 to 1 agree, and 0.2 where nothing moves.
    if sum(agrees.values()) < max(1, 0.6 * len(agrees)):
        return {}

    def is_late(camera: int) -> bool:
        own = [pair for pair in curves if camera in pair]
        if len(own) < 2 or abs(offsets[camera]) < PARTS_OF_FRAME / 2 or np.mean([agrees[pair] for pair in own]) < 0.5:
            return False
        without = [lags[pair] - int(offsets[camera]) * (1 if camera == pair[1] else -1) for pair in own]
        places = ((pair, np.array([lags[pair], lag]) - LAGS[0]) for pair, lag in zip(own, without, strict=True))
        at = [np.nan_to_num(curves[pair][place]) for pair, place in places]
        gains = -np.diff(at, axis=1)
        return bool(gains.mean() >= 3 * max(float(gains.std(ddof=1)), 0.01) / np.sqrt(len(gains)))

    return {name: float(offsets[c]) / PARTS_OF_FRAME for c, name in enumerate(names) if is_late(c)}


def compare(scene: MultiviewScene, frames: range, progress: Progress = silent) -> Curves:
    """Return the correlation of neighbouring cameras for each lag. Raises SceneError for a broken picture."""
    pictures = ScenePictures(scene, TrainSettings(max_size=240), (1, 1))
    cameras, signals = pictures.cameras(), list[Signals]()
    bins = {(a, b): both for a, b in neighbours(cameras, 8) if (both := _shared_bins(cameras[a], cameras[b]))}
    for index in range(len(cameras)):
        own = {pair: both[pair.index(index)] for pair, both in bins.items() if index in pair}
        signals.append(_signals(pictures, index, frames, own) if own else {})
        progress("looking for cameras out of step", index + 1, len(cameras))
    return {(a, b): correlate(signals[a][a, b], signals[b][a, b]) for a, b in bins}


def _shared_bins(a: Camera, b: Camera) -> tuple[NDArray[np.intp], ...] | None:
    """Return (H * W,) bins of pixels' angles around the baseline of two cameras, BINS where the other sees none."""
    along, ahead = b.position - a.position, a.world_to_camera[2, :3] + b.world_to_camera[2, :3]
    along = along / (np.linalg.norm(along) or 1.0)
    ahead = ahead - along * (ahead @ along)
    ahead /= np.linalg.norm(ahead) or 1.0
    if not (along.any() and ahead.any()):
        return None
    angles = [np.arctan2(rays @ np.cross(along, ahead), rays @ ahead) for rays in (_rays(a), _rays(b))]
    low, high = max(angle.min() for angle in angles), min(angle.max() for angle in angles)
    if high - low < 0.05:  # radians that both must see
        return None
    bins = (np.floor((angle - low) / (high - low) * BINS).astype(np.intp) for angle in angles)
    return tuple(np.where((of >= 0) & (of < BINS), of, BINS) for of in bins)


def _rays(camera: Camera) -> NDArray[np.float64]:
    x = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    y = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    u, v = np.meshgrid(x, y)
    return np.stack([u, v, np.ones_like(u)], axis=-1).reshape(-1, 3) @ camera.world_to_camera[:3, :3]


def _signals(pictures: ScenePictures, index: int, frames: range, bins: Mapping[Pair, NDArray[np.intp]]) -> Signals:
    """Return mean motion of the pixels in each bin, from each frame to the next."""
    sizes = {pair: np.maximum(np.bincount(places, minlength=BINS + 1)[:BINS], 1) for pair, places in bins.items()}
    out, before = {pair: np.zeros((len(frames) - 1, BINS)) for pair in bins}, None
    for place, frame in enumerate(frames):
        view = pictures.seen_by(index, frame)
        grey = 255 * view.target.rgb.mean(axis=2).ravel() if view else None  # what moved around a hole is not known
        if before is not None and grey is not None:
            motion = np.abs(grey - before)
            motion = np.clip(motion - 3 * np.median(motion) / 0.6745, 0, 30)  # a camera's noise is no motion
            moving = np.flatnonzero(motion)
            for pair, places in bins.items():
                out[pair][place - 1] = np.bincount(places[moving], motion[moving], BINS + 1)[:BINS] / sizes[pair]
        before = grey
    return out


def correlate(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (L,) correlations of two signals (T, B) for each lag by which the second is late.

    NaN where they overlap by less than 0.4 or 6 frames. Bins weigh the same, but for those in which little ever moves.
    """
    fine, levelled = np.arange(PARTS_OF_FRAME * (len(first) - 1) + 1) / PARTS_OF_FRAME, []
    for signal in (first, second):
        spread = signal.std(axis=0)
        level = signal / (spread + 0.5 * np.sqrt(np.mean(spread**2)) + 1e-9)  # 0 / 0 where nothing moves
        levelled.append(CubicSpline(np.arange(len(signal)), level)(fine))
    (a, b), out = levelled, np.full(len(LAGS), np.nan)
    for place, lag in enumerate(LAGS.tolist()):
        if len(fine) - abs(lag) >= PARTS_OF_FRAME * max(6, 0.4 * len(first)):
            p, q = a[max(0, -lag) : len(a) - max(0, lag)], b[max(0, lag) : len(b) - max(0, -lag)]
            p, q = p - p.mean(axis=0), q - q.mean(axis=0)
            out[place] = (p * q).sum() / np.sqrt((p * p).sum() * (q * q).sum() + 1e-12)
    return out


def solve(curves: Curves, count: int) -> NDArray[np.intp]:
    """Return (count,) offsets in quarters of a frame at which pairs correlate best; the lower median is 0.

    From the offsets along the strongest pairs that connect the cameras (a minimum spanning tree), each camera in turn
    takes the offset that is best for its pairs until none changes. A pair counts as much as it can correlate at all.
    """
    weighed = {pair: np.nan_to_num(curve * max(np.nanmax(curve), 0), nan=-1.0) for pair, curve in curves.items()}
    places, lags = np.array(list(weighed), np.intp).reshape(-1, 2).T, np.zeros((count, count), np.intp)
    costs = [2 - curve.max() for curve in weighed.values()]
    of: list[list[tuple[int, NDArray[np.float64]]]] = [[] for _ in range(count)]
    for (a, b), curve in weighed.items():
        of[a].append((b, curve[::-1]))
        of[b].append((a, curve))
        lags[a, b] = LAGS[curve.argmax()]
        lags[b, a] = -lags[a, b]
    tree = minimum_spanning_tree(coo_array((costs, (places[0], places[1])), shape=(count, count)))
    order, before = breadth_first_order(tree, 0, directed=False)
    offsets, reach, middle = np.zeros(count, np.intp), REACH * PARTS_OF_FRAME, len(LAGS) // 2
    for camera in order[1:]:
        offsets[camera] = offsets[before[camera]] + lags[before[camera], camera]
    offsets = np.clip(offsets - int(np.median(offsets)), -reach, reach)
    grid = np.arange(-reach, reach + 1)
    for _ in range(100):
        start = offsets.copy()
        for camera, pairs in enumerate(of):
            if pairs:
                offsets[camera] = grid[sum(curve[middle + grid - offsets[o]] for o, curve in pairs).argmax()]
        if np.array_equal(start, offsets):
            break
    return offsets - np.sort(offsets)[(count - 1) // 2]


def in_step(scene: MultiviewScene, offsets: Mapping[str, float], span: FrameRange = (0, None)) -> MultiviewScene:
    """Return frames [A, B) of a scene, in whose frame t each camera shows what it took first from t + its offset on.

    An offset is in frames, positive where a camera is late, and 0 unless named. Frames that not all cameras have are
    left out, and as many later ones taken in, where there are any. Points are those of the first frame of the scene.

    Raises SceneError for missing frames, a name that no camera has, cameras that move, and offsets that leave no frame.
    """
    first, end = frames_of(scene, span)
    late, names = {name: offset for name, offset in offsets.items() if offset}, [c.name for c in scene.cameras]
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
    shots = [[_shot_from(scene, i, frame + offset) for i, offset in enumerate(of)] for frame in range(start, stop)]
    frames = tuple(tuple(filter(None, of_frame)) for of_frame in dropwhile(lambda of_frame: None in of_frame, shots))
    if not frames:
        raise SceneError(f"{scene.path}: expected offsets that leave a frame of {end - first} to all cameras")
    return replace(scene, frames=frames, offsets=late, points=None if first else scene.points)


def _shot_from(scene: MultiviewScene, index: int, time: float) -> Shot | None:
    frame = math.ceil(time - WHOLE)
    if (place := scene.place(frame, index)) is None:
        return None
    after, shot = round(frame - time, 6), scene.frames[frame][place]
    return replace(shot, after=after) if after > WHOLE else shot


def read_offsets(path: Path) -> dict[str, float]:
    """Read the offsets in a JSON file, an object of cameras' names and frames. Raises SceneError."""
    table = read_object(path)
    with expecting(path, "an object of cameras and by how many frames each is late"):
        for name, offset in table.items():
            if isinstance(offset, bool) or not isinstance(offset, (int, float)) or not math.isfinite(offset):
                raise ValueError(f"got {offset!r} for {name}")
    return {name: float(offset) for name, offset in table.items()}
