"""Multi-view scenes of CMU Panoptic as Dynamic 3D Gaussians has it: train_meta.json, pictures in ims/, masks in seg/.

A mask is not 0 where something moves.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

from airgs_codec.scene.cameras import panoptic
from airgs_codec.scene.cameras.posed import Posed, expecting, read_object
from airgs_codec.scene.sequence_json import DEFAULT_FPS, exact_number, frame_rate
from airgs_codec.train.data.multiview import MultiviewScene, PictureFile, Shot, in_frames


def has_panoptic(folder: Path) -> bool:
    """Whether the folder has a train_meta.json."""
    return (folder / panoptic.NAME).is_file()


def read_panoptic(folder: Path) -> MultiviewScene:
    """The scene of a train_meta.json, and of the test_meta.json beside it. Raises SceneError."""
    path = folder / panoptic.NAME
    posed = panoptic.read(path)
    with expecting(path, "a frame rate"):
        fps = frame_rate(str(path), exact_number(str(read_object(path).get("fps", DEFAULT_FPS))))
    return MultiviewScene(folder, fps, in_frames(posed, partial(_shot, folder)))


def _shot(folder: Path, posed: Posed) -> Shot:
    mask = folder / "seg" / Path(posed.picture).with_suffix(".png")
    return Shot(posed.camera, PictureFile(folder / "ims" / posed.picture), None, mask if mask.is_file() else None)
