"""The formats of clips: which files are theirs, and what opens them. To add one, write its module and its row."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from airgs_codec.scene.formats.clip import Bake, Clip
from airgs_codec.scene.formats.fourdgs import open_4dgs
from airgs_codec.scene.formats.spacetime_ply import is_spacetime_ply, open_spacetime_ply
from airgs_codec.scene.formats.splat4d import open_splat4d
from airgs_codec.scene.formats.splatv import open_splatv
from airgs_codec.scene.ply_elements import read_header

Open = Callable[[Path, Bake], Clip]  # raises SceneError


@dataclass(frozen=True, slots=True)
class ClipFormat:
    """A format of files that hold many frames each."""

    name: str
    suffix: str
    open: Open


CLIP_FORMATS = (
    ClipFormat(".splatv", ".splatv", open_splatv),
    ClipFormat(".4dgs", ".4dgs", open_4dgs),
    ClipFormat(".splat4d", ".splat4d", open_splat4d),
    ClipFormat("Spacetime Gaussians .ply", ".ply", open_spacetime_ply),
)
_BY_SUFFIX = {form.suffix: form for form in CLIP_FORMATS}
SUFFIXES = tuple(suffix for suffix in _BY_SUFFIX if suffix != ".ply")


def clip_format(path: Path) -> ClipFormat | None:
    """The format of a file that is a clip, None for a frame. Raises SceneError where a .ply has no header."""
    form = None if path.is_dir() else _BY_SUFFIX.get(path.suffix.lower())
    return None if form and form.suffix == ".ply" and not is_spacetime_ply(read_header(path)) else form


def is_clip(path: Path) -> bool:
    """Whether a file is there that is a clip. Raises SceneError where a .ply has no header."""
    return path.is_file() and clip_format(path) is not None
