"""Images: files, filters, lenses, features. H x W pixels, C channels; RGB is always in this order."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from airgs_codec._arguments import path_argument
from airgs_codec.errors import ConfigError, SceneError
from airgs_codec.places.whole import atomic_path

Value = TypeVar("Value")
Doubles = NDArray[np.float64]

WIDEST = np.radians(120)  # along the longer side of undistorted pictures
NARROWER = np.geomspace(1, 32, 64)  # factors of the focal length that are tried
LEAST_USED = 0.25  # pixels of a taken picture for one of the undistorted, along a line through its middle
SLACK = 0.01  # of a side, by which OpenCV's estimates of what was seen err
LOOKED_AT = 48  # places along a side, at which a lens is tried
# OpenCV counts pixel centres from 0, we have the first at 0.5: added to a matrix of theirs, it gives ours.
TO_CENTRES = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
ORIENTATION = 0x0112  # of EXIF; 1: as it is stored
_FORMATS = ("PNG", "JPEG", "WEBP", "TIFF", "BMP", "PPM", "GIF", "JPEG2000", "AVIF")  # of pictures that are read


def to_bytes(rgb: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Return (H, W, 3) RGB of [0, 1] as 8 bit; what lies outside is shown at the nearer bound, as a screen does."""
    return np.rint(np.clip(rgb, 0, 1) * 255).astype(np.uint8)


def to_floats(samples: NDArray[np.uint8]) -> NDArray[np.float32]:
    return samples.astype(np.float32) / np.float32(255)


def encode_png(rgb: NDArray[np.uint8]) -> bytes:
    return bytes(cv2.imencode(".png", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))[1])


def write_png(path: Path, rgb: NDArray[np.uint8]) -> None:
    path.write_bytes(encode_png(rgb))


def save_png(path: str | Path, rgb: NDArray[np.floating]) -> None:
    """Write (H, W, 3) RGB of [0, 1] as PNG, whole or not at all. Raises ConfigError for another ending, or OSErrors."""
    target = Path(path_argument("path", path))
    if target.suffix.lower() != ".png":
        raise ConfigError(f"{target}: expected a name that ends in .png")
    try:
        with atomic_path(target) as temporary:
            write_png(temporary, to_bytes(rgb))
    except OSError as error:
        raise ConfigError(f"{target}: cannot write the picture: {error.strerror or error}") from error


def encode_jpeg(rgb: NDArray[np.uint8], quality: int) -> bytes:
    """Return (H, W, 3) RGB as JPEG of a `quality` up to 100, which comes in rough first."""
    options = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_PROGRESSIVE, 1, cv2.IMWRITE_JPEG_OPTIMIZE, 1]
    return bytes(cv2.imencode(".jpg", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), options)[1])


def read_picture(path: Path, size: tuple[int, int] | None = None) -> NDArray[np.uint8]:
    """Read (H, W, 3) RGB of 8 bits, or (H, W, 4) where the file has alpha; of 16 bits the upper 8 are used.

    Raises SceneError when the file is not a picture of 8 or 16 bits and of `size` = (width, height), None for any, by
    its header, or has more pixels than Pillow takes for a picture.
    """
    return _read(path, size, _samples)


def check_picture(path: Path, size: tuple[int, int]) -> None:
    """Raise SceneError where `read_picture` would by the header alone."""
    _read(path, size, lambda picture: None)


def _read(path: Path, size: tuple[int, int] | None, take: Callable[[Image.Image], Value]) -> Value:
    """Return what `take` gives of a picture of a size; errors are those of `read_picture`."""
    try:
        if not path.is_file():  # opening a pipe would wait
            raise ValueError("No such file")
        with Image.open(path, formats=_FORMATS) as picture:
            if picture.format == "TIFF" and picture.getexif().get(ORIENTATION, 1) != 1:
                raise ValueError("stored as it is shown, got a TIFF with an orientation")
            found = picture.size
            if size in (None, found):
                return take(picture)
    except Exception as error:  # whatever a decoder comes upon in a broken file
        reason = " ".join(str(getattr(error, "strerror", None) or error).split())[:200]
        raise SceneError(f"{path}: expected a picture: {reason}") from error
    expected, got = (f"{width}x{height}" for width, height in (size or found, found))
    raise SceneError(f"{path}: expected a picture of {expected}, got {got}")


def is_turned(path: Path) -> bool:
    """Return whether the header of a picture says that it is shown turned, which `read_picture` does not do."""
    try:
        return _read(path, None, lambda picture: "exif" in picture.info and picture.getexif().get(ORIENTATION, 1) != 1)
    except SceneError:
        return False  # whoever reads it says why


def _samples(picture: Image.Image) -> NDArray[np.uint8]:
    if picture.mode.startswith("I;16"):
        return np.repeat((np.asarray(picture) >> 8).astype(np.uint8)[..., None], 3, axis=2)
    if picture.mode in ("I", "F"):
        raise ValueError("of 8 or 16 bits, got samples of 32")
    return np.asarray(picture.convert("RGBA" if picture.has_transparency_data else "RGB"))


def decode_rgba(data: bytes, form: str, most: float = np.inf, most_pixels: float = np.inf) -> NDArray[np.uint8]:
    """Decode (H, W, 4) samples of a picture in Pillow's format `form`, up to `most` pixels a side and `most_pixels`.

    Those of lossless WebP are exactly as they are stored. Raises ValueError for what is broken, or larger.
    """
    try:
        with Image.open(io.BytesIO(data), formats=(form,)) as picture:
            if max(picture.size) > most or picture.size[0] * picture.size[1] > most_pixels:
                expected = f"{most} pixels a side" if most < np.inf else f"{most_pixels} pixels"
                raise ValueError(f"at most {expected}, got {picture.size[0]}x{picture.size[1]}")
            return np.asarray(picture.convert("RGBA"))
    except UnidentifiedImageError as error:
        raise ValueError("got something else") from error
    except Exception as error:  # whatever a decoder comes upon in a broken file
        raise ValueError(" ".join(str(error).split())[:200]) from error


def read_mask(path: Path, size: tuple[int, int]) -> NDArray[np.float32]:
    """Read (H, W) of 0 and 1 from a picture of `size` (width, height): 1 where it is not black. Raises SceneError."""
    return np.any(read_picture(path, size)[..., :3], axis=2).astype(np.float32)


def label(rgb: NDArray[np.uint8], text: str, line: int = 0) -> NDArray[np.uint8]:
    """Return a copy of (H, W, 3) 8-bit RGB with white text on a dark band: line 0 is at the top."""
    out = rgb.copy()
    top = 18 * line
    out[top : top + 18] //= 3
    cv2.putText(out, text, (5, top + 13), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (255, 255, 255), 1, cv2.LINE_AA)
    return out


def contact_sheet(pictures: Sequence[NDArray[np.uint8]], captions: Sequence[str], columns: int) -> NDArray[np.uint8]:
    """Return pictures (H, W, 3) of one size, 8-bit RGB, under captions of some lines, `columns` in a row, on black."""
    tiles = []
    for picture, caption in zip(pictures, captions, strict=True):
        for line, text in enumerate(caption.splitlines()):
            picture = label(picture, text, line)
        tiles.append(picture)
    tiles += [np.zeros_like(tiles[0])] * (-len(tiles) % columns)
    return np.concatenate([np.concatenate(tiles[i : i + columns], axis=1) for i in range(0, len(tiles), columns)])


def blur(picture: NDArray[np.float32], kernel: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return (H, W, 3) filtered by a 1-D kernel in both directions; borders are mirrored."""
    return cv2.sepFilter2D(picture, -1, kernel, kernel, borderType=cv2.BORDER_REFLECT_101).astype(np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class Lens:
    """A camera with distortion, and the pinhole camera that its pictures are resampled for; matrices in pixels."""

    size: tuple[int, int]  # width, height
    matrix: Doubles  # (3, 3) intrinsics of the real camera
    coefficients: Doubles  # OpenCV's k1 k2 p1 p2 [k3 k4 k5 k6], or k1..k4 of a fisheye
    fisheye: bool
    pinhole: Doubles  # (3, 3) intrinsics of the undistorted picture
    cut: bool = False  # whether it shows less than could be undistorted

    def maps(self, size: tuple[int, int]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return x and y, (H, W) each, in the taken picture of pixels of the undistorted one at a (width, height)."""
        scale = np.diag([size[0] / self.size[0], size[1] / self.size[1], 1])
        given = self.matrix - TO_CENTRES, self.coefficients, np.eye(3), scale @ self.pinhole - TO_CENTRES
        make = cv2.fisheye.initUndistortRectifyMap if self.fisheye else cv2.initUndistortRectifyMap
        x, y = make(*given, size, cv2.CV_32FC1)
        return np.asarray(x, np.float32), np.asarray(y, np.float32)

    def sees(self) -> bool:
        """Return whether the taken picture has all pixels of the undistorted one in order, and enough of them."""
        (width, height), (x, y) = self.size, self.maps((LOOKED_AT, LOOKED_AT))
        (down_x, along_x), (down_y, along_y) = np.gradient(x), np.gradient(y)
        areas = (along_x * down_y - down_x * along_y) * LOOKED_AT**2 / (width * height)
        inside = (np.abs(x / width - 0.5) <= 0.5 + SLACK) & (np.abs(y / height - 0.5) <= 0.5 + SLACK)
        middle = areas.ravel()[areas.size // 2 + LOOKED_AT // 2]
        return bool(inside.all() and (areas > 0).all() and middle >= LEAST_USED**2)


def fit_lens(size: tuple[int, int], matrix: Doubles, coefficients: Doubles, fisheye: bool = False) -> Lens:
    """Return the lens whose pinhole camera is the widest of the same size all of whose pixels the real camera saw.

    It sees WIDEST at most, and ends where the lens would show something twice. `size` is (width, height), `matrix`
    (3, 3), `coefficients` are OpenCV's of the model. Raises ValueError where no such camera sees anything.
    """
    given = matrix - TO_CENTRES, coefficients
    middle = np.array([[[size[0] / 2, size[1] / 2]]]) - 0.5
    if fisheye:
        new = cv2.fisheye.estimateNewCameraMatrixForUndistortRectify(*given, size, np.eye(3), balance=0.0)
        ahead = cv2.fisheye.undistortPoints(middle, *given).ravel()
    else:
        new, _ = cv2.getOptimalNewCameraMatrix(*given, size, 0)
        ahead = cv2.undistortPoints(middle, *given).ravel()
    found, least = Lens(size, matrix, coefficients, fisheye, new + TO_CENTRES), max(size) / 2 / np.tan(WIDEST / 2)
    if new[0, 0] >= least and found.sees():
        return found
    for focal in least * NARROWER:
        fx, fy = focal, focal * matrix[1, 1] / matrix[0, 0]
        pinhole = np.array([[fx, 0, size[0] / 2 - fx * ahead[0]], [0, fy, size[1] / 2 - fy * ahead[1]], [0, 0, 1]])
        if (narrower := replace(found, pinhole=pinhole, cut=True)).sees():
            return narrower
    raise ValueError("expected a lens that shows what is before it, once")


def undistort(picture: NDArray[np.float32], lens: Lens) -> NDArray[np.float32]:
    """Return (H, W, C) resampled to what the pinhole camera of `lens` would have seen."""
    return np.asarray(cv2.remap(picture, *lens.maps(lens.size), cv2.INTER_LINEAR), np.float32)


def resize(picture: NDArray[np.float32], width: int, height: int) -> NDArray[np.float32]:
    """Return (H, W, C) at another size in pixels; where it shrinks, pixels are averaged over their area."""
    if picture.shape[1::-1] == (width, height):
        return picture
    return np.asarray(cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA), np.float32)


def box_mean(values: NDArray[np.float32], size: int) -> NDArray[np.float32]:
    """Return (H, W) means over `size` x `size` pixels around each; borders are mirrored."""
    return np.asarray(cv2.blur(values, (size, size), borderType=cv2.BORDER_REFLECT_101), np.float32)


def sift(picture: NDArray[np.float32], most: int) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """Find the F <= `most` strongest SIFT features (Lowe 2004) of (H, W, 3) RGB of [0, 1].

    Returns positions (F, 2) in pixels, x first, the first pixel's centre at (0.5, 0.5), and descriptors (F, 128).
    """
    grey = cv2.cvtColor(to_bytes(picture), cv2.COLOR_RGB2GRAY)
    found, descriptors = cv2.SIFT.create(nfeatures=most).detectAndCompute(grey, None)
    if descriptors is None:
        return np.empty((0, 2)), np.empty((0, 128), np.float32)
    return np.array([f.pt for f in found], np.float64) + 0.5, np.asarray(descriptors, np.float32)


def match_features(a: NDArray[np.float32], b: NDArray[np.float32], ratio: float) -> NDArray[np.intp]:
    """Return (M, 2) pairs of rows of descriptors `a` (A, 128) and `b` (B, 128) that are each other's nearest.

    The second nearest must be further by 1 / `ratio` on both sides (Lowe's ratio test).
    """
    if len(a) < 2 or len(b) < 2:
        return np.empty((0, 2), np.intp)
    matcher = cv2.BFMatcher(cv2.NORM_L2)

    def nearest(x: NDArray[np.float32], y: NDArray[np.float32]) -> dict[int, int]:
        pairs = matcher.knnMatch(x, y, k=2)
        return {p.queryIdx: p.trainIdx for p, second in pairs if p.distance < ratio * second.distance}

    forward, back = nearest(a, b), nearest(b, a)
    return np.array([(i, j) for i, j in forward.items() if back.get(j) == i], np.intp).reshape(-1, 2)
