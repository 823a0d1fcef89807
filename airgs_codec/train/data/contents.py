"""Names of what the pictures of a scene show, which change where the pictures do.

A picture is named by the bytes of its file. A frame of a video is named by those of the whole video and its number,
since decoding all frames takes far longer than reading the file: where a video changes, all its frames do.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from airgs_codec.errors import SceneError
from airgs_codec.jobs.work import Work
from airgs_codec.train.data.multiview import MultiviewScene, Shot

CHUNK = 32  # files that are read by one call

Contents = Mapping[Path, str]  # SHA-256 of each file, hexadecimal


def read_contents(scene: MultiviewScene, work: Work) -> Contents:
    """Read the files of all pictures and masks of a scene once. Raises SceneError for one that cannot be read."""
    files = sorted({file for shots in scene.frames for shot in shots for file in _files(shot)})
    parts = [files[at : at + CHUNK] for at in range(0, len(files), CHUNK)]
    digests = work.map("pictures", hash_files, [(part,) for part in parts])
    return dict(zip(files, (digest for part in digests for digest in part), strict=True))


def hash_files(paths: Sequence[Path]) -> list[str]:
    """SHA-256 of each file. Raises SceneError."""
    digests = []
    for path in paths:
        try:
            with path.open("rb") as file:
                digests.append(hashlib.file_digest(file, "sha256").hexdigest())
        except OSError as error:
            raise SceneError(f"{path}: expected a picture or a video: {error.strerror}") from error
    return digests


def content_of(scene: MultiviewScene, contents: Contents) -> list[Any]:
    """What a job that reads a scene is named by."""
    frames = [
        (number, [_content(shot, contents) for shot in shots]) for number, shots in enumerate(scene.frames) if shots
    ]
    return [scene.background, scene.points, frames]


def with_frames(scene: MultiviewScene, frames: Iterable[int]) -> MultiviewScene:
    """The scene without the pictures of all other frames, which keep their numbers."""
    wanted = set(frames)
    return replace(scene, frames=tuple(s if i in wanted else () for i, s in enumerate(scene.frames)))


def without_masks(scene: MultiviewScene) -> MultiviewScene:
    """The scene of which all is trained."""
    return replace(scene, frames=tuple(tuple(replace(s, mask=None) for s in shots) for shots in scene.frames))


def _content(shot: Shot, contents: Contents) -> tuple[Any, ...]:
    path, number = shot.source.file()
    return shot.camera, shot.lens, contents[path], number, shot.mask and contents[shot.mask]


def _files(shot: Shot) -> list[Path]:
    return [shot.source.file()[0], *([shot.mask] if shot.mask else [])]
