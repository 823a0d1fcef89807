"""How good is a training where nobody trained it? Several splits of a scene's cameras, and judges for each.

The cameras of the scene are shuffled with a fixed seed and dealt out: split i holds out cameras i * hold to
i * hold + hold - 1 of that order. Every split is an `airgs-train` of its own into FOLDER/split-I (one that is there
goes on), with the options given. For every held-out camera, at the times of its pictures:

    psnr      mean over frames of its PSNR in dB, in the look of the model
    matched   the same after a gain and an offset for each colour, found for that camera over all frames: no camera that
              nobody trained on can tell how it was exposed
    haze      from half-way to the middle of the scene, with the camera's near plane: share of the picture's light
              paths that end in Gaussians nearer than a tenth of the way that is left (0: clear, 1: fog)
    light     mean of that picture over the mean of what the camera filmed (near 0: black)

The gap is the training PSNR less the held-out one, both matched; half-way.png shows what is seen half-way, and the
page's picture the last frame from the best, the middle and the lowest held-out camera.
"""

from __future__ import annotations

import math
import shlex
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from airgs_codec.cli.options import parse_frames
from airgs_codec.errors import ConfigError
from airgs_codec.media.image import contact_sheet, to_bytes, write_png
from airgs_codec.media.metrics import low_psnr, mse, psnr
from airgs_codec.render import Camera, cpu, read_cameras
from airgs_codec.scene.camera import BLACK, looked_at
from airgs_codec.scene.gaussians import SH_C0, Gaussians
from airgs_codec.trainer.data.multiview import MultiviewScene, with_held_out, with_near
from airgs_codec.trainer.data.pictures import ScenePictures, View
from airgs_codec.trainer.data.readers import open_scene
from airgs_codec.trainer.data.sync import in_step
from airgs_codec.trainer.frames import frame_before
from airgs_codec.trainer.record import ModelFolder, known_offsets, read_model
from airgs_codec.trainer.settings import Temporal, TrainSettings
from tools.lab import Lab, Page, PagePicture, Section, Table, required, rows_of, setting

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SEED = 1  # of the order in which cameras are dealt out
WAY = 0.5  # to the middle of the scene
NEAR_SHARE = 0.1  # of the way that is left: what is nearer than this there is fog
COLUMNS = {
    "scene": ("scene", ""), "cameras": ("held-out cameras", ""), "psnr": ("PSNR, dB", ".1f"),
    "matched": ("with matched colours", ".1f"), "trained": ("trained cameras, matched", ".1f"),
    "worst": ("worst 5 % of pictures", ".1f"),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Options:
    scene: Path = required("what airgs-train reads")
    splits: int = setting(4, "how many")
    hold: int = setting(4, "cameras that each holds out")
    only: tuple[int, ...] = setting((), "numbers of the splits to do")
    frames: str = setting(":", "A:B, as airgs-train has it")
    train: str = setting("", "further options of airgs-train, in one word")


@dataclass(frozen=True, slots=True)
class Row:
    split: int
    camera: str
    psnr: float
    matched: float
    haze: float
    light: float


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """A split: its cameras, its training views, and pictures for each of its cameras."""

    rows: list[Row]
    errors: list[float]  # mean squared ones of all pictures of its cameras, in the look of the model
    training: float  # dB, matched
    half_way: list[NDArray[np.uint8]]  # what is seen half-way
    last: list[tuple[NDArray[np.uint8], NDArray[np.uint8]]]  # what was filmed last, and what is shown


def run(options: Options, lab: Lab) -> Page:
    """All splits one after the other. Raises ConfigError for splits that the scene has no cameras for."""
    names = [camera.name for camera in open_scene(options.scene).cameras]
    if options.splits * options.hold > len(names) or options.hold < 1:
        asked = f"{options.splits} splits of {options.hold}"
        raise ConfigError(f"{options.scene}: {asked} need more than its {len(names)} cameras")
    order = np.random.default_rng(SEED).permutation(len(names))
    judged = []
    for number in options.only or range(options.splits):
        held_out = [names[i] for i in order[number * options.hold : (number + 1) * options.hold]]
        folder = lab.folder / f"split-{number}"
        train(options.scene, folder, held_out, ["--frames", options.frames, *shlex.split(options.train)])
        late = known_offsets(folder) or {}
        scene = with_held_out(in_step(open_scene(options.scene), late, parse_frames(options.frames)), held_out)
        judged.append(judge(number, scene, folder))
        lab.tell(f"{summary(options.scene.resolve().name, judged)}")
    rows = [row for split in judged for row in split.rows]
    captions = [f"split {row.split} {row.camera}, haze {row.haze:.3f}" for row in rows]
    sheet = contact_sheet([picture for split in judged for picture in split.half_way], captions, columns=4)
    write_png(lab.folder / "half-way.png", sheet)
    name = options.scene.resolve().name
    how = (
        f"{options.hold} cameras of {len(names)} held out in each split, dealt out anew; matched: after a gain and an "
        "offset for each colour of a camera."
    )
    pairs = [pair for split in judged for pair in split.last]
    tall, wide = pairs[0][0].shape[:2]
    size = 9, 6 * tall / wide + 0.4
    caption = "What held-out cameras filmed (above), and what the model shows them"
    picture = PagePicture(f"splits-{name}", caption, partial(draw, rows, pairs), size)
    means = Table(f"splits-{name}-means", [summary(name, judged)], COLUMNS)
    return Page([Section("", "", [picture], [means])], how, data=[Table(f"splits-{name}", rows_of(rows))])


def summary(name: str, judged: Sequence[Judged]) -> dict[str, str | float]:
    """Return means over held-out cameras in dB, below what 5 % of their pictures are, and what trained cameras have."""
    rows = [row for split in judged for row in split.rows]
    return {
        "scene": name, "splits": len(judged), "cameras": len(rows), "psnr": float(np.mean([row.psnr for row in rows])),
        "matched": float(np.mean([row.matched for row in rows])),
        "trained": float(np.mean([split.training for split in judged])),
        "worst": low_psnr([error for split in judged for error in split.errors]), "haze": max(row.haze for row in rows),
    }  # fmt: skip


def draw(rows: Sequence[Row], pairs: Sequence[tuple[NDArray[np.uint8], NDArray[np.uint8]]], figure: Figure) -> None:
    order = sorted(range(len(rows)), key=lambda at: -rows[at].psnr)
    chosen = dict.fromkeys([order[0], order[len(order) // 2], order[-1]])
    for axes, at in zip(figure.subplots(2, len(chosen), squeeze=False).T, chosen, strict=True):
        for axis, picture in zip(axes, pairs[at], strict=True):
            axis.imshow(picture)
            axis.axis("off")
        axes[0].set_title(f"{rows[at].camera}, {rows[at].psnr:.1f} dB", fontsize=9)


def train(scene: Path, folder: Path, held_out: Sequence[str], options: Sequence[str]) -> None:
    """`airgs-train` with these options. Raises ConfigError when it fails."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    program = [sys.executable, "-c", "import sys; from airgs_codec.cli.train import main; sys.exit(main())"]
    named = ["-o", str(folder), "--hold-out", ",".join(held_out), "--resume", *options]
    if subprocess.run([*program, str(scene), *named], check=False, stdout=subprocess.DEVNULL).returncode:
        raise ConfigError(f"{folder}: airgs-train failed")


def judge(number: int, scene: MultiviewScene, folder: Path) -> Judged:
    model = read_model(folder)
    pictures = open_pictures(scene, model)
    frames = range(len(model.record.frames))
    first = model.read(0)
    cameras = [view.camera for view in (*pictures.train(0), *pictures.held_out(0))]
    middle = looked_at(cameras)
    rows, errors, half_way, last = [], [], [], []
    for views in zip(*(pictures.held_out(frame) for frame in frames), strict=True):
        shown, camera = shown_to(model, views), views[0].camera
        plain, matched = compare(shown, views)
        errors += plain
        picture, haze = from_half_way(first, camera, middle)
        light = float(picture.mean() / views[0].target.rgb.mean())
        rows.append(Row(number, camera.name, _mean_db(plain), matched, haze, light))
        half_way.append(to_bytes(picture))
        last.append((to_bytes(views[-1].target.rgb), to_bytes(cpu.render(shown[-1], camera).rgb)))
    every = zip(*(pictures.train(frame) for frame in frames), strict=True)
    training = [compare(shown_to(model, views), views)[1] for views in every]
    return Judged(rows, errors, float(np.mean(training)), half_way, last)


def shown_to(model: ModelFolder, views: Sequence[View]) -> list[Gaussians]:
    """What a camera sees of a model at the times of its pictures, one of each frame."""
    return [
        frame_before(model, frame + 1).at(view.after) if view.after else model.read(frame)
        for frame, view in enumerate(views)
    ]


def open_pictures(scene: MultiviewScene, model: ModelFolder) -> ScenePictures:
    """The pictures that a model was trained on, and those of its held-out cameras, in the look of the model."""
    table = model.record.settings
    drop = math.inf if table["max_drop_db"] is None else table["max_drop_db"]
    settings = TrainSettings(**{**table, "temporal": Temporal(**table["temporal"]), "max_drop_db": drop})
    near = min(camera.near for camera in read_cameras(model.folder))
    pictures = ScenePictures(with_near(scene, near), settings)
    return pictures.with_exposure(model.record.exposure) if model.record.exposure else pictures


def compare(shown: Sequence[Gaussians], views: Sequence[View]) -> tuple[list[float], float]:
    """Mean squared errors of one camera, and its mean PSNR in dB with the gain and offset that fit all frames best."""
    pairs = [
        (cpu.render(g, view.camera).rgb.reshape(-1, 3), view.target.rgb.reshape(-1, 3))
        for g, view in zip(shown, views, strict=True)
    ]
    plain = [mse(a, b) for a, b in pairs]
    matched = [np.empty_like(a) for a, _ in pairs]
    for channel in range(3):
        x = np.concatenate([a[:, channel] for a, _ in pairs]).astype(np.float64)
        y = np.concatenate([b[:, channel] for _, b in pairs]).astype(np.float64)
        gain, offset = np.polyfit(x, y, 1)
        for (a, _), out in zip(pairs, matched, strict=True):
            out[:, channel] = gain * a[:, channel] + offset
    return plain, _mean_db([mse(m, b) for m, (_, b) in zip(matched, pairs, strict=True)])


def _mean_db(errors: Sequence[float]) -> float:
    return float(np.mean([psnr(error) for error in errors]))


def from_half_way(g: Gaussians, camera: Camera, middle: NDArray[np.float64]) -> tuple[NDArray[np.float32], float]:
    """The picture (H, W, 3) that the camera would see half-way to the middle, and the haze in it."""
    step = WAY * (middle - camera.position)
    view = camera.world_to_camera.copy()
    view[:3, 3] -= view[:3, :3] @ step
    moved = replace(camera, world_to_camera=view, near=camera.near)
    near = np.linalg.norm(g.means - (camera.position + step), axis=1) < NEAR_SHARE * np.linalg.norm(step)
    white = np.where(near, 0.5, -0.5).astype(np.float32) / np.float32(SH_C0)
    marked = replace(g.with_degree(0), sh_dc=np.repeat(white[:, None], 3, axis=1))
    haze = float(cpu.render(marked, replace(moved, background=BLACK)).rgb.mean())
    return np.clip(cpu.render(g, moved).rgb, 0, 1), haze
