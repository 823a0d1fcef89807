"""What every section is given: scenes, a folder, the rows that are kept."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from airgs_codec import __version__
from airgs_codec.decoder.decode import decode_frames
from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.errors import ConfigError
from airgs_codec.media.h264 import library_versions
from airgs_codec.media.metrics import mse
from airgs_codec.package.store import Package, open_package
from airgs_codec.render import Camera, render
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.sequence import GaussianSequence, open_sequence
from tools.precision.rows import Kept, Row

DATA = Path(__file__).parents[2] / "tests" / "data"
FOX, FOX_VIEWS = DATA / "fox", DATA / "fox_views"
FOX_FPS = 24
SPINACH_VIEWS = "spinach_views.json"  # beside the clip
SPINACH_FRAMES = 8  # of the clip, the first ones


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A sequence by a name."""

    name: str
    sequence: GaussianSequence

    @property
    def identity(self) -> dict[str, Any]:
        """What tells it from other scenes of that name."""
        return {"name": self.name, "frames": len(self.sequence), "rows": [h.count for h in self.sequence.headers]}


@dataclass(frozen=True, slots=True, eq=False)
class Bench:
    """What all sections share."""

    scenes: tuple[Scene, ...]  # the first is the fox
    folder: Path  # of packages, models and kept rows
    kept: Kept
    quick: bool = False

    def once(self, scene: Scene | None, settings: dict[str, Any], work: Callable[[], Iterable[Row]]) -> list[Row]:
        """`Kept.once` with what else the figures depend on: the scene and the versions of the code."""
        versions = library_versions() | {"airgs-codec": __version__}
        return self.kept.once({**settings, "scene": scene and scene.identity, "versions": versions}, work)

    def package(self, scene: Scene, settings: EncodeSettings, name: str) -> Package:
        """A package of a scene, encoded once; `name` tells it from others of the scene."""
        folder = self.folder / f"{scene.name}-{len(scene.sequence)}-{name}.airgs"
        if not (folder / "manifest.mpd").is_file():
            encode(scene.sequence, folder, settings)
        return open_package(folder)

    def ladder(self, scene: Scene) -> Package:
        """The package that the default settings make."""
        return self.package(scene, EncodeSettings(), "ladder")


def open_scene(spec: str) -> Scene:
    """The scene that NAME=FOLDER or NAME=FOLDER=VIEWS names. Raises ConfigError, SceneError."""
    name, _, rest = spec.partition("=")
    folder, _, views = rest.partition("=")
    if not (name and folder):
        raise ConfigError(f"--scene: expected NAME=FOLDER or NAME=FOLDER=VIEWS, got {spec!r}")
    return Scene(name, open_sequence(folder, views=views or None, fps=FOX_FPS))


def open_spinach(path: Path) -> Scene:
    """The first frames of the clip, with the cameras beside it. Raises SceneError."""
    sequence = open_sequence(path, views=path.parent / SPINACH_VIEWS)
    some = slice(0, SPINACH_FRAMES)
    return Scene("spinach", replace(sequence, paths=sequence.paths[some], headers=sequence.headers[some]))


def picture_error(shown: Gaussians, original: Gaussians, camera: Camera) -> float:
    """Mean squared error of one picture."""
    return mse(render(shown, camera).rgb, render(original, camera).rgb)


def shown_frames(package: Package, frames: Sequence[int]) -> dict[int, Gaussians]:
    """Some frames of the top rung, decoded."""
    wanted = set(frames)
    return {f.number: f.gaussians for f in decode_frames(package, 0, package.manifest.frames) if f.number in wanted}
