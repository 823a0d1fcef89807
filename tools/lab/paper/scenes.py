"""Which scenes are compared on, and how much of each: NAME=FOLDER, then options after commas."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from airgs_codec.cli.common import parse_frames
from airgs_codec.errors import ConfigError
from airgs_codec.trainer.data.multiview import MultiviewScene, with_held_out, with_near
from airgs_codec.trainer.data.pictures import Pictures
from airgs_codec.trainer.data.readers import open_scene
from tools.lab.baselines.method import Footage

OPTIONS = ("frames", "size", "near", "held")
QUICK_FRAMES, QUICK_SIZE = 4, 128  # most of a scene in a quick run


@dataclass(frozen=True, slots=True)
class Subject:
    name: str
    folder: Path
    frames: tuple[int, int | None] = (0, None)  # [start, stop)
    size: int | None = None  # longest side of the pictures in pixels; None: as they are
    near: float | None = None  # near plane in world units; None: as the scene has it
    held: tuple[str, ...] = ()  # cameras that are held out; none: those that the scene says

    def quick(self) -> Subject:
        start, stop = self.frames
        last = start + QUICK_FRAMES if stop is None else min(stop, start + QUICK_FRAMES)
        return replace(self, frames=(start, last), size=min(self.size or QUICK_SIZE, QUICK_SIZE))

    def words(self) -> dict[str, object]:
        words = {"scene": self.folder.resolve().name, "frames": self.frames, "size": self.size, "near": self.near}
        return words | ({"held": self.held} if self.held else {})

    def open(self) -> MultiviewScene:
        """The scene, some of its cameras held out. Raises SceneError."""
        scene = with_held_out(open_scene(self.folder, frames=self.frames), self.held or None)
        return scene if self.near is None else with_near(scene, self.near)

    def footage(self, folder: Path) -> Footage:
        """Return what a method is trained on, into a folder. Raises SceneError."""
        scene = self.open()
        return Footage(Pictures(scene, max_size=self.size), len(scene), scene.points, folder, self.words())


def parse_subject(text: str) -> Subject:
    """NAME=FOLDER[,frames=A:B][,size=PX][,near=Z][,held=CAMERA+CAMERA...]. Raises ConfigError."""
    first, *rest = text.split(",")
    name, _, folder = first.partition("=")
    options = dict(part.partition("=")[::2] for part in rest)
    if not name or not folder or set(options) - set(OPTIONS):
        raise ConfigError(f"--scene: expected NAME=FOLDER with {', '.join(OPTIONS)} after commas, got {text!r}")
    try:
        size = int(options["size"]) if "size" in options else None
        near = float(options["near"]) if "near" in options else None
    except ValueError as error:
        raise ConfigError(f"--scene {text!r}: {error}") from error
    held = tuple(filter(None, options.get("held", "").split("+")))
    return Subject(name, Path(folder), parse_frames(options.get("frames")), size, near, held)
