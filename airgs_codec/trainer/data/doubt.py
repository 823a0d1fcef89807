"""Cameras whose pictures plainly do not fit their poses: poses of two swapped, a picture mirrored, or of another scene.

A camera is doubted where its features match those of its neighbours, if at all, where its pose says that they cannot,
while those of the other cameras mostly do not, and its motion is not theirs either (`sync`), where that is known. Where
cameras have little in common anyway nothing can be told. N cameras, M matches.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from airgs_codec.media.image import match_features, sift
from airgs_codec.progress import Progress, silent
from airgs_codec.scene.camera import Camera
from airgs_codec.trainer.data.multiview import MultiviewScene
from airgs_codec.trainer.data.pictures import Pictures
from airgs_codec.trainer.fit.points import FEATURES, NEIGHBOURS, RATIO, REPROJECTION, neighbours

SIDE = 480  # pixels, the longest side of the pictures that are compared
# Measured on `multiview/fox`, `basketball` and `kinoptic`, as they are and with cameras that were made wrong.
CHANCE = 0.1  # share of matches that agree with any poses, at most
USUAL = 12  # matches of a camera that agree, by the median, from which something can be told
ANYHOW = 5  # matches that may agree by chance, however few there are
FEW, RARE = 0.1, 0.15  # of the medians of what agrees, and of its share: what either is below, where motion is unknown
MOVES = 0.4  # median likeness of motion from which it tells something
ALONE = 1 / 3  # of the median: the motion of a camera that is like no other's; those of the three rigs have 0.58 and
# more, but for a camera that is some 15 frames early
UNLIKE = 0.75  # of the median: the motion of a camera that may be wrong


def find_doubtful(scene: MultiviewScene, likeness: Mapping[str, float], progress: Progress = silent) -> list[str]:
    """Names of the cameras whose pictures of the first frame do not fit their poses.

    `likeness`: what `sync.Timing` has. Raises SceneError for a picture that cannot be read.
    """
    pictures = Pictures(scene, max_size=SIDE, picture_bytes=1, target_bytes=1)
    cameras = pictures.cameras()
    features = []
    for index in range(len(cameras)):
        features.append(sift(pictures.view(0, index).target.rgb, FEATURES))
        progress("looking for cameras that are wrong", index + 1, len(cameras))
    found, agreeing = np.zeros((2, len(cameras)), int)
    for a, b in neighbours(cameras, NEIGHBOURS):
        pairs = match_features(features[a][1], features[b][1], RATIO)
        agree = epipolar_distances(cameras[a], cameras[b], features[a][0][pairs[:, 0]], features[b][0][pairs[:, 1]])
        for camera in (a, b):
            found[camera] += len(pairs)
            agreeing[camera] += int((agree < REPROJECTION).sum())
    motion = np.array([likeness.get(camera.name, np.nan) for camera in cameras])
    return [cameras[index].name for index in np.flatnonzero(doubted(found, agreeing, motion))]


def doubted(found: NDArray[np.int_], agreeing: NDArray[np.int_], motion: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(N,) which cameras are wrong, from their matches and those of them that agree with the poses.

    `motion` (N,): likeness to that of neighbours; NaN: not known.
    """
    if not len(found) or np.median(agreeing) < USUAL:
        return np.zeros(len(found), np.bool_)
    share = agreeing / np.maximum(found, 1)
    weak = (agreeing <= np.maximum(ANYHOW, CHANCE * found)) & ((share <= np.median(share) / 3) | (agreeing <= 2))
    usual = float(np.nanmedian(motion)) if np.isfinite(motion).any() else 0.0
    if usual >= MOVES:
        return np.asarray(weak & ~(motion > UNLIKE * usual), np.bool_)
    rare = (agreeing <= FEW * np.median(agreeing)) | (share <= RARE * np.median(share))
    return np.asarray(weak & rare, np.bool_)


def moving_alone(likeness: Mapping[str, float]) -> list[str]:
    """Names of the cameras whose motion is like no other's, where that of the others is alike.

    `likeness`: what `sync.Timing` has.
    """
    usual = float(np.median(list(likeness.values()))) if likeness else 0.0
    return [name for name, alike in likeness.items() if usual >= MOVES and alike < ALONE * usual]


def epipolar_distances(
    a: Camera, b: Camera, first: NDArray[np.float64], second: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(M,) larger distance of two places (M, 2), in pixels, from the line on which the other camera has what is seen.

    Infinite where both cameras are in one place, which has no such lines.
    """
    turn = b.world_to_camera[:3, :3] @ a.world_to_camera[:3, :3].T
    x, y, z = b.world_to_camera[:3, 3] - turn @ a.world_to_camera[:3, 3]
    lens = [np.array([[c.fx, 0, c.cx], [0, c.fy, c.cy], [0, 0, 1]]) for c in (a, b)]
    essential = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ turn  # Hartley and Zisserman, 9.6
    fundamental = np.linalg.inv(lens[1]).T @ essential @ np.linalg.inv(lens[0])
    left, right = (np.c_[places, np.ones(len(places))] for places in (first, second))
    lines, others = left @ fundamental.T, right @ fundamental
    with np.errstate(divide="ignore", invalid="ignore"):
        apart = np.abs((right * lines).sum(axis=1))
        distances = apart / np.minimum(*(np.linalg.norm(line[:, :2], axis=1) for line in (lines, others)))
    return np.asarray(np.nan_to_num(distances, nan=np.inf), np.float64)
