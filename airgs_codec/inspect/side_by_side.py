"""A picture of what a camera sees of A and of B, and of their difference. H x W pixels, 8-bit RGB."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from airgs_codec.inspect.sides import Side
from airgs_codec.inspect.two import Seen
from airgs_codec.media.image import contact_sheet, to_bytes
from airgs_codec.render import render

LABEL = 36  # pixels above each picture, for two lines
LEAST_WIDTH = 320  # pixels; smaller pictures are shown with larger pixels, so that labels have room
MOST_LETTERS = 44  # of a line
MOST_GAIN = 64
SHOWN = 0.999  # of the differences are not cut off


def side_by_side(a: Side, b: Side, seen: Seen) -> NDArray[np.uint8]:
    """(LABEL + H, 3 W, 3): A, B and their difference as one camera sees them, with labels above."""
    frames = range(seen.frame, seen.frame + 1)
    first, second = (np.clip(render(next(side.read(frames)), seen.camera).rgb, 0, 1) for side in (a, b))
    difference = np.abs(first - second)
    gain = difference_gain(difference)
    captions = [
        f"A, the reference: {a.label}\nframe {seen.frame}, camera {seen.camera.name}",
        f"B: {b.label}\n{seen.psnr:.2f} dB",
        f"difference x {gain}\nlargest {difference.max():.3f} of 1",
    ]
    pictures = [_with_room(to_bytes(picture)) for picture in (first, second, gain * difference)]
    return contact_sheet(pictures, ["\n".join(map(_shortened, text.split("\n"))) for text in captions], columns=3)


def difference_gain(difference: NDArray[np.float32]) -> int:
    """The power of 2, at most MOST_GAIN, that differences of [0, 1] are multiplied by to be seen."""
    large = float(np.quantile(difference, SHOWN))
    return MOST_GAIN if large * MOST_GAIN <= 1 else 2 ** max(0, math.floor(-math.log2(large)))


def _with_room(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A picture below a black band, its pixels as many times as wide as it needs."""
    times = math.ceil(LEAST_WIDTH / picture.shape[1])
    return np.pad(picture.repeat(times, axis=0).repeat(times, axis=1), ((LABEL, 0), (0, 0), (0, 0)))


def _shortened(text: str) -> str:
    return text if len(text) <= MOST_LETTERS else f"{text[: MOST_LETTERS - 12]}..{text[-10:]}"
