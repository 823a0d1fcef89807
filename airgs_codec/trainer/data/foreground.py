"""Masks of what moves before cameras that stand still, for scenes that have none.

A camera's first masks are what its pictures differ from its plate in now or soon, with what that encloses, cut along
edges by colours (GrabCut) that are those of the whole run; what stands before a plate that looks more like the
background is kept whatever its colours. Their visual hull is what the cameras agree on: its
silhouettes, cut in the same way, are the masks. They have parts that a camera alone would miss, and nothing that no
others support. How well first masks and silhouettes agree tells whether there is one subject that they show.

H x W pixels of pictures whose longest side is SIZE; masks are written at the size of the pictures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError
from airgs_codec.media.image import box_mean, to_bytes
from airgs_codec.media.masks import (
    Colours,
    Mask,
    closed,
    cut_out,
    distorted,
    filled,
    grown,
    learn_colours,
    opened,
    scaled,
    touching,
    unlike_background,
    write_mask,
)
from airgs_codec.progress import Progress, silent
from airgs_codec.trainer.data.hull import FEWEST as FEWEST_CAMERAS
from airgs_codec.trainer.data.hull import silhouette, visual_hull
from airgs_codec.trainer.data.multiview import MultiviewScene, Shot
from airgs_codec.trainer.data.pictures import Pictures
from airgs_codec.trainer.data.plates import SAMPLES, WINDOW, Masks, Plate, plate_of, stands_still
from airgs_codec.trainer.settings import AUTO, TrainSettings

SIZE = 320  # pixels
FEWEST_FRAMES = 5
AGREEMENT = (
    0.5  # least mean IoU of first masks and silhouettes: 0.38 where they miss the subject, 0.56 where they do not
)
SHARE = 0.6  # of the cameras that see a cell of the hull and have it in their first masks
SOON = 12  # frames before and after one, in which what moves is near the subject
REACH = 0.03  # of the longest side: gaps in what moves, how far the subject may be from it, and where its background is
DIFFERS = 15.0  # of 255, at least, and three times the tolerance of the plate
SHADE = 0.45, 1.03  # bounds of a shadow's brightness, over the plate's
TINT = 0.12  # most that a shadow's colours differ in that
DARK = 8.0  # of 255, added to both: ratios of dark colours are noise
SMALL = 0.0008  # of a picture: parts that are left out
LEARNED = 8  # pictures that colours are learned from


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """Masks of each camera, frame by frame, and how well cameras agree: mean IoU, 0..1."""

    masks: list[Masks]
    agreement: float


def finds_masks(scene: MultiviewScene, settings: TrainSettings) -> bool:
    """Whether a run finds masks: there is a picture without one, and it shall have one."""
    return settings.foreground == AUTO and any(shot.mask is None for shots in scene.frames for shot in shots)


def with_found_masks(scene: MultiviewScene, folder: Path, progress: Progress = silent) -> MultiviewScene:
    """The scene with a mask for each picture: its own, or one in `folder`, which is found unless it is there.

    They are CAMERA/FRAME.png there, white where the subject is. Raises SceneError where none can be found (`find_masks`
    has why), or cameras do not agree on a subject.
    """
    paths = [[_path(folder, shot, frame) for shot in shots] for frame, shots in enumerate(scene.frames)]
    if not all(path.is_file() for row in paths for path in row):
        found = find_masks(scene, progress)
        if found.agreement < AGREEMENT:
            raise SceneError(
                f"{scene.path}: cameras agree on the foreground by {100 * found.agreement:.0f} %, expected at least "
                f"{100 * AGREEMENT:.0f}: give masks beside the pictures, or train all of them with --foreground off"
            )
        for frame, (shots, row) in enumerate(zip(scene.frames, paths, strict=True)):
            for shot, path, masks in zip(shots, row, found.masks, strict=True):
                if not path.is_file():
                    path.parent.mkdir(parents=True, exist_ok=True)
                    write_mask(path, _full(masks[frame], shot))
    frames = zip(scene.frames, paths, strict=True)
    return replace(
        scene,
        frames=tuple(tuple(replace(s, mask=path) for s, path in zip(*pair, strict=True)) for pair in frames),
    )


def find_masks(scene: MultiviewScene, progress: Progress = silent) -> Found:
    """Find the masks of all cameras; held-out ones tell nothing about others.

    Raises SceneError for a camera that moves, too few frames or training cameras, pictures that cannot be read, and
    where nothing moves.
    """
    _expect_plates(scene)
    pictures = Pictures(scene, max_size=SIZE)
    cameras, frames = pictures.cameras(), range(len(scene))
    told = [i for i, camera in enumerate(cameras) if not camera.held_out]
    total = 2 * len(cameras) + len(frames)
    first, shown = [], list[list[Mask]]()
    for i in range(len(cameras)):
        first.append(_first_masks(_Film(pictures, i, len(frames))))
        progress("masks", i + 1, total)
    for frame in frames:
        hull = visual_hull([cameras[i] for i in told], [first[i][frame] for i in told], SHARE)
        shown.append([silhouette(hull, camera) for camera in cameras])
        progress("masks", len(cameras) + frame + 1, total)
    agreement = float(np.mean([_iou(first[i][frame], shown[frame][i]) for frame in frames for i in told]))
    if not any(first[i][frame].any() for frame in frames for i in told):
        raise SceneError(f"{scene.path}: to find its foreground, expected something that moves, got nothing")
    masks = []
    for i in range(len(cameras)):
        masks.append(_cut(_Film(pictures, i, len(frames)), Masks(row[i] for row in shown)))
        progress("masks", len(cameras) + len(frames) + i + 1, total)
    return Found(masks, agreement)


@dataclass(frozen=True, eq=False)
class _Film:
    """The pictures (H, W, 3) of one camera."""

    pictures: Pictures
    camera: int
    frames: int

    def __getitem__(self, frame: int) -> NDArray[np.uint8]:
        return to_bytes(self.pictures.view(frame, self.camera).target.rgb)

    @cached_property
    def plate(self) -> Plate:
        """What it shows where nothing moves."""
        return plate_of([self[frame] for frame in self.spread(SAMPLES)])

    @property
    def reach(self) -> int:
        """REACH in pixels."""
        camera = self.pictures.cameras()[self.camera]
        return max(1, round(REACH * max(camera.width, camera.height)))

    def spread(self, most: int) -> list[int]:
        """Up to so many frames, evenly over the run."""
        found: list[int] = np.unique(np.linspace(0, self.frames - 1, most).round().astype(int)).tolist()
        return found


def _expect_plates(scene: MultiviewScene) -> None:
    cameras = sum(not camera.held_out for camera in scene.cameras)
    for good, message in (
        (stands_still(scene), "cameras that stand still, each with a name of its own"),
        (len(scene) >= FEWEST_FRAMES, f"at least {FEWEST_FRAMES} frames, got {len(scene)}"),
        (cameras >= FEWEST_CAMERAS, f"at least {FEWEST_CAMERAS} training cameras, got {cameras}"),
    ):
        if not good:
            raise SceneError(
                f"{scene.path}: to find its foreground, expected {message}: give masks beside the pictures"
            )


def _first_masks(film: _Film) -> Masks:
    """What one camera alone tells."""
    moving = Masks(_moves(film[frame], film.plate) for frame in range(film.frames))
    around = (range(max(0, frame - SOON), min(film.frames, frame + SOON + 1)) for frame in range(film.frames))
    return _cut(film, Masks(_enclosed(np.any([moving[i] for i in near], axis=0), film.reach) for near in around))


def _moves(picture: NDArray[np.uint8], plate: Plate) -> Mask:
    """Where a picture (H, W, 3) differs from its plate, but for shadows: they keep its tint."""
    now, rest = (box_mean(values.astype(np.float32), WINDOW) for values in (picture, plate.rgb))
    differs = np.abs(now - rest).max(axis=2) > max(DIFFERS, 3 * 255 * plate.tolerance)
    shade = (now + DARK) / (rest + DARK)
    dimmed = (shade.mean(axis=2) > SHADE[0]) & (shade.mean(axis=2) < SHADE[1])
    return differs & ~(dimmed & (np.ptp(shade, axis=2) < TINT))


def _enclosed(moving: Mask, reach: int) -> Mask:
    """The outlines of what moves, and what is within them."""
    return filled(closed(opened(moving, 1), reach), SMALL * moving.size)


def _cut(film: _Film, priors: Sequence[Mask]) -> Masks:
    """The masks near `priors` that follow edges; empty where there is too little to learn colours from."""
    reach, front, back = film.reach, [], []
    for frame in film.spread(LEARNED):
        near = grown(priors[frame], reach)
        front.append(film[frame][priors[frame]])
        back.append(film[frame][grown(priors[frame], 4 * reach) & ~near])
    colours = learn_colours(np.concatenate(front), np.concatenate(back))

    def cut(frame: int) -> Mask:
        if colours is None:
            return np.zeros_like(priors[frame])
        sure = priors[frame] & _stands_before(film[frame], film.plate, colours)
        found = opened(cut_out(film[frame], grown(priors[frame], reach), sure, colours), 1)
        return touching(found, priors[frame])

    return Masks(cut(frame) for frame in range(film.frames))


def _stands_before(picture: NDArray[np.uint8], plate: Plate, colours: Colours) -> Mask:
    """Where a picture (H, W, 3) differs from its plate, and the plate is more like the background."""
    moves = _moves(picture, plate)
    now, rest = (unlike_background(values[moves], colours) for values in (picture, plate.rgb))
    sure = np.zeros_like(moves)
    sure[moves] = now > rest
    return opened(sure, 1)


def _iou(a: Mask, b: Mask) -> float:
    """Intersection over union; 1 where both are empty."""
    return float((a & b).sum() / either) if (either := int((a | b).sum())) else 1.0


def _full(mask: Mask, shot: Shot) -> Mask:
    """The mask at the size of the picture that was taken."""
    whole = scaled(mask, (shot.camera.width, shot.camera.height))
    return distorted(whole, shot.lens) if shot.lens else whole


def _path(folder: Path, shot: Shot, frame: int) -> Path:
    """The mask of a shot; cameras may have any name."""
    name = quote(shot.camera.name, safe="").replace(".", "%2E")
    return shot.mask or folder / name / f"{frame:06d}.png"
