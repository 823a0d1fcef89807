"""Masks: their shapes, cutting along the edges of a picture, and files. H x W pixels, radii in pixels."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from airgs_codec.media.image import TO_CENTRES, Lens
from airgs_codec.places.whole import write_bytes

Mask = NDArray[np.bool_]  # (H, W)

SAMPLES = 20_000  # most pixels of each kind that colours are learned from
FEWEST = 500  # of each kind, for ten normal distributions
ROW = 100  # samples in a row of the picture that they are learned in
ROUNDS = 12  # of learning
ANYWHERE = (0, 0, 0, 0)  # GrabCut's rectangle, where a mask tells more


@dataclass(frozen=True, slots=True, eq=False)
class Colours:
    """Mixtures of five normal distributions each, as `cv2.grabCut` has them."""

    background: NDArray[np.float64]
    foreground: NDArray[np.float64]


def grown(mask: Mask, radius: int) -> Mask:
    """The mask and all that is at most `radius` from it."""
    return cv2.dilate(mask.astype(np.uint8), _disc(radius)) > 0


def opened(mask: Mask, radius: int) -> Mask:
    """The mask without what is narrower than twice the radius."""
    return cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, _disc(radius)) > 0


def closed(mask: Mask, radius: int) -> Mask:
    """The mask with gaps that are narrower than twice the radius."""
    around = np.pad(mask.astype(np.uint8), radius)
    return cv2.morphologyEx(around, cv2.MORPH_CLOSE, _disc(radius))[radius:-radius, radius:-radius] > 0


def filled(mask: Mask, least: float) -> Mask:
    """The mask without holes, and without parts that then have fewer than `least` pixels."""
    outlines, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    whole = cv2.drawContours(np.zeros(mask.shape, np.uint8), outlines, -1, 1, cv2.FILLED)
    _, parts, numbers, _ = cv2.connectedComponentsWithStats(whole)
    large = numbers[:, cv2.CC_STAT_AREA] >= least
    large[0] = False  # what is in no part
    return large[parts]


def touching(mask: Mask, seeds: Mask) -> Mask:
    """The parts of a mask that some of the `seeds` (H, W) are in."""
    _, parts = cv2.connectedComponents(mask.astype(np.uint8))
    return mask & np.isin(parts, np.unique(parts[mask & seeds]))


def learn_colours(foreground: NDArray[np.uint8], background: NDArray[np.uint8]) -> Colours | None:
    """Colours of pixels (N, 3) that may be foreground, less those that look like the background's (M, 3).

    GrabCut (Rother et al. 2004) on a picture of them. None where there are fewer than FEWEST of a kind.
    """
    if min(len(foreground), len(background)) < FEWEST:
        return None
    front, back = (s[:: max(1, len(s) // SAMPLES)] for s in (foreground, background))
    front, back = (s[: len(s) // ROW * ROW].reshape(-1, ROW, 3) for s in (front, back))
    kinds = np.full((len(front) + len(back), ROW), cv2.GC_BGD, np.uint8)
    kinds[: len(front)] = cv2.GC_PR_FGD
    found = Colours(np.zeros((1, 65)), np.zeros((1, 65)))
    cv2.setRNGSeed(0)
    picture = np.ascontiguousarray(np.concatenate([front, back]))
    cv2.grabCut(picture, kinds, ANYWHERE, found.background, found.foreground, ROUNDS, cv2.GC_INIT_WITH_MASK)
    return found


def unlike_background(pixels: NDArray[np.uint8], colours: Colours) -> NDArray[np.float64]:
    """(N,) how improbable the background makes pixels (N, 3): the negative logarithm of their density."""
    weights, means, covariances = np.split(colours.background[0], [5, 20])
    density = np.full(len(pixels), np.finfo(np.float64).tiny)
    for weight, mean, covariance in zip(weights, means.reshape(5, 3), covariances.reshape(5, 3, 3), strict=True):
        if weight > 0:
            inverse, away = np.linalg.inv(covariance), pixels - mean
            distance = np.einsum("ni,ij,nj->n", away, inverse, away)
            density += weight * np.sqrt(np.linalg.det(inverse)) * np.exp(-distance / 2)
    return -np.log(density)


def cut_out(picture: NDArray[np.uint8], near: Mask, sure: Mask, colours: Colours) -> Mask:
    """What has the colours of the foreground in a picture (H, W, 3) within the mask `near`, along its edges.

    `sure`: what is foreground whatever its colours.
    """
    if not near.any():
        return near
    rows, columns = (np.flatnonzero(near.any(axis=axis)) for axis in (1, 0))
    window = slice(max(0, rows[0] - 1), rows[-1] + 2), slice(max(0, columns[0] - 1), columns[-1] + 2)
    kinds = np.where(near[window], cv2.GC_PR_FGD, cv2.GC_BGD).astype(np.uint8)
    kinds[(near & sure)[window]] = cv2.GC_FGD
    back, front = colours.background.copy(), colours.foreground.copy()
    cv2.grabCut(np.ascontiguousarray(picture[window]), kinds, ANYWHERE, back, front, 1, cv2.GC_EVAL_FREEZE_MODEL)
    cut = np.zeros(near.shape, np.bool_)
    cut[window] = (kinds == cv2.GC_FGD) | (kinds == cv2.GC_PR_FGD)
    return cut


def scaled(mask: Mask, size: tuple[int, int]) -> Mask:
    """A mask at another size (width, height), with smooth edges."""
    return cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_LINEAR) > 0.5


def distorted(mask: Mask, lens: Lens) -> Mask:
    """A mask of the pinhole camera of `lens` as the real camera would have seen it; the reverse of `undistort`."""
    width, height = lens.size
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 1, 2).astype(np.float64)
    undistort = cv2.fisheye.undistortPoints if lens.fisheye else cv2.undistortPoints
    matrix, pinhole = lens.matrix - TO_CENTRES, lens.pinhole - TO_CENTRES
    there = undistort(pixels, matrix, lens.coefficients, R=np.eye(3), P=pinhole).reshape(height, width, 2)
    columns, rows = np.moveaxis(there.astype(np.float32), 2, 0)
    return cv2.remap(mask.astype(np.float32), columns, rows, cv2.INTER_LINEAR) > 0.5


def write_mask(path: Path, mask: Mask) -> None:
    """Write a mask as a PNG of one bit a pixel, white where it is, whole or not at all."""
    options = [cv2.IMWRITE_PNG_BILEVEL, 1]
    write_bytes(path, cv2.imencode(".png", mask.astype(np.uint8) * 255, options)[1].tobytes(), lasting=False)


def _disc(radius: int) -> NDArray[np.uint8]:
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1)), np.uint8)
