"""Reading and writing pictures. The only importer of cv2."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError


def to_bytes(rgb: NDArray[np.floating]) -> NDArray[np.uint8]:
    """(H, W, 3) RGB of [0, 1] -> 8 bit; what lies outside is shown at the bound, as a screen does."""
    return np.rint(np.clip(rgb, 0, 1) * 255).astype(np.uint8)


def write_png(path: Path, rgb: NDArray[np.uint8]) -> None:
    """Write an (H, W, 3) RGB picture."""
    _, data = cv2.imencode(".png", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))
    path.write_bytes(data.tobytes())


def read_picture(path: Path) -> NDArray[np.uint8]:
    """(H, W, 3) RGB, or (H, W, 4) where the file has alpha. Raises SceneError when the file is not a picture."""
    picture = _decode(path, cv2.IMREAD_UNCHANGED)
    if picture.dtype == np.uint16:
        picture = (picture >> 8).astype(np.uint8)
    if picture.dtype != np.uint8:
        raise SceneError(f"{path}: expected a picture of 8 or 16 bits, got {picture.dtype}")
    if picture.ndim == 2:
        return np.repeat(picture[..., None], 3, axis=2)
    order = cv2.COLOR_BGR2RGB if picture.shape[2] == 3 else cv2.COLOR_BGRA2RGBA
    return np.asarray(cv2.cvtColor(picture, order), np.uint8)


def read_png(path: Path) -> NDArray[np.float32]:
    """(H, W, 3) RGB of [0, 1]. Raises SceneError when the file is not a picture."""
    return np.float32(1 / 255) * cv2.cvtColor(_decode(path, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)


def read_mask(path: Path, size: tuple[int, int]) -> NDArray[np.float32]:
    """(H, W) of 0 and 1: 1 where the picture of width x height `size` is not black. Raises SceneError."""
    mask = _decode(path, cv2.IMREAD_GRAYSCALE)
    if mask.shape[::-1] != size:
        raise SceneError(f"{path}: expected a mask of {size[0]}x{size[1]}, got {mask.shape[1]}x{mask.shape[0]}")
    return (mask > 0).astype(np.float32)


def _decode(path: Path, flags: int) -> NDArray:
    data = np.fromfile(path, np.uint8) if path.is_file() else np.empty(0, np.uint8)
    picture = cv2.imdecode(data, flags) if data.size else None
    if picture is None:
        raise SceneError(f"{path}: expected a picture, got {'something else' if data.size else 'nothing'}")
    return picture


def label(rgb: NDArray[np.uint8], text: str, line: int = 0) -> NDArray[np.uint8]:
    """A copy of the (H, W, 3) picture with a line of white text on a dark band at the top."""
    out = rgb.copy()
    top = 18 * line
    out[top : top + 18] //= 3
    cv2.putText(out, text, (5, top + 13), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (255, 255, 255), 1, cv2.LINE_AA)
    return out


def blur(picture: NDArray[np.float32], kernel: NDArray[np.float32]) -> NDArray[np.float32]:
    """Separable filter of an (H, W, 3) picture by a 1-D kernel; borders mirrored."""
    return cv2.sepFilter2D(picture, -1, kernel, kernel, borderType=cv2.BORDER_REFLECT_101).astype(np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class Lens:
    """A camera with distortion, and the pinhole camera its pictures are turned into."""

    size: tuple[int, int]  # width, height
    matrix: NDArray[np.float64]  # (3, 3) intrinsics of the real camera
    coefficients: NDArray[np.float64]  # OpenCV's k1 k2 p1 p2 [k3 k4 k5 k6], or k1..k4 of a fisheye
    fisheye: bool
    pinhole: NDArray[np.float64]  # (3, 3) intrinsics of the undistorted picture


def fit_lens(
    size: tuple[int, int], matrix: NDArray[np.float64], coefficients: NDArray[np.float64], fisheye: bool = False
) -> Lens:
    """The widest pinhole camera of the same size all of whose pixels the real one saw.

    OpenCV counts pixel centres from 0; matrices here have them at +0.5, as `Camera`.
    """
    shift = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    if fisheye:
        new = cv2.fisheye.estimateNewCameraMatrixForUndistortRectify(
            matrix - shift, coefficients, size, np.eye(3), balance=0.0
        )
    else:
        new, _ = cv2.getOptimalNewCameraMatrix(matrix - shift, coefficients, size, 0)
    return Lens(size, matrix, coefficients, fisheye, new + shift)


def undistort(picture: NDArray[np.float32], lens: Lens) -> NDArray[np.float32]:
    """The (H, W, C) picture as the pinhole camera of `lens` would have seen it."""
    shift = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    maps = cv2.fisheye.initUndistortRectifyMap if lens.fisheye else cv2.initUndistortRectifyMap
    arguments = (lens.matrix - shift, lens.coefficients, np.eye(3), lens.pinhole - shift, lens.size, cv2.CV_32FC1)
    return np.asarray(cv2.remap(picture, *maps(*arguments), cv2.INTER_LINEAR), np.float32)


def resize(picture: NDArray[np.float32], width: int, height: int) -> NDArray[np.float32]:
    """The picture at another size; pixels are averaged over their area when it shrinks."""
    if picture.shape[1::-1] == (width, height):
        return picture
    return np.asarray(cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA), np.float32)


def box_mean(values: NDArray[np.float32], size: int) -> NDArray[np.float32]:
    """(H, W) mean over `size` x `size` pixels; borders mirrored."""
    return np.asarray(cv2.blur(values, (size, size), borderType=cv2.BORDER_REFLECT_101), np.float32)


def sift(picture: NDArray[np.float32], most: int) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """At most `most` SIFT features of an (H, W, 3) picture: positions (F, 2), centres at +0.5, and descriptors."""
    grey = cv2.cvtColor(to_bytes(picture), cv2.COLOR_RGB2GRAY)
    found, descriptors = cv2.SIFT.create(nfeatures=most).detectAndCompute(grey, None)
    if descriptors is None:
        return np.empty((0, 2)), np.empty((0, 128), np.float32)
    return np.array([f.pt for f in found], np.float64) + 0.5, np.asarray(descriptors, np.float32)


def match_features(a: NDArray[np.float32], b: NDArray[np.float32], ratio: float) -> NDArray[np.intp]:
    """(M, 2) rows of descriptors `a` and `b`: each other's nearest, and nearer than `ratio` of the second nearest."""
    if len(a) < 2 or len(b) < 2:
        return np.empty((0, 2), np.intp)
    matcher = cv2.BFMatcher(cv2.NORM_L2)

    def nearest(x: NDArray[np.float32], y: NDArray[np.float32]) -> dict[int, int]:
        pairs = matcher.knnMatch(x, y, k=2)
        return {p.queryIdx: p.trainIdx for p, second in pairs if p.distance < ratio * second.distance}

    there, back = nearest(a, b), nearest(b, a)
    return np.array([(i, j) for i, j in there.items() if back.get(j) == i], np.intp).reshape(-1, 2)
