"""Views at half their size: large motion is a small one there, and an iteration costs less.

H x W pixels. Nothing is kept: a halved picture is made of the whole one whenever it is asked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec.media.image import resize
from airgs_codec.render.cpu import TILE, Redraw, Render
from airgs_codec.scene.camera import with_pixels
from airgs_codec.train.data.pictures import Picture, View
from airgs_codec.train.loss.target import Target

LEAST = 160  # pixels on the shorter side of a picture that is halved: smaller ones lose what moves in them


@dataclass(frozen=True, slots=True, eq=False)
class Halved:
    """A picture at half its size."""

    whole: Picture
    size: tuple[int, int]  # width and height

    def target(self) -> Target:
        """The picture in float32. Raises SceneError where it cannot be read."""
        whole = self.whole.target()
        return Target(resize(whole.rgb, *self.size), None if whole.clear is None else resize(whole.clear, *self.size))

    def expect(self) -> None:
        """It will be asked for soon."""
        self.whole.expect()


def can_be_halved(views: Sequence[View]) -> bool:
    """Whether all pictures are large enough."""
    return all(min(view.camera.width, view.camera.height) >= LEAST for view in views)


def halve(view: View) -> View:
    """The view at half its size, or half a pixel more. A tile is drawn again where one of the four in it would be."""
    size = -(-view.camera.width // 2), -(-view.camera.height // 2)
    redraw = view.redraw and _halve_redraw(view.redraw, size)
    return View(with_pixels(view.camera, *size), Halved(view.picture, size), redraw)


def _halve_redraw(redraw: Redraw, size: tuple[int, int]) -> Redraw:
    def rest() -> Render:
        whole = redraw.rest()
        return Render(resize(whole.rgb, *size), resize(whole.transmittance, *size))

    return replace(redraw, tiles=_any_of_four(redraw.tiles, size), rest=rest)


def _any_of_four(tiles: NDArray[np.bool_], size: tuple[int, int]) -> NDArray[np.bool_]:
    """(down, across) of pictures of a size, from (down', across') of pictures twice as large."""
    across, down = (-(-pixels // TILE) for pixels in size)
    padded = np.zeros((2 * down, 2 * across), np.bool_)
    padded[: tiles.shape[0], : tiles.shape[1]] = tiles
    return np.asarray(padded.reshape(down, 2, across, 2).any(axis=(1, 3)))
