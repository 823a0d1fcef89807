"""How training generalises: cameras are held out some at a time, in several splits, and each trained model is judged
from the cameras that it has not seen.

    python -m tools.bench_splits SCENE -o OUT [--splits N] [--hold N] [--only I,J] [--frames A:B]
        [-- options of airgs-train]

The cameras of the scene are shuffled with a fixed seed and dealt out: split i holds out cameras i * hold to
i * hold + hold - 1 of that order. Every split is an `airgs-train` of its own into OUT/split-I (one that is there goes
on), with the options given. For every held-out camera:

    psnr      mean over frames of its PSNR in dB, in the look of the model
    matched   the same after a gain and an offset for each colour, found for that camera over all frames: no camera that
              nobody trained on can tell how it was exposed
    haze      from half-way to the middle of the scene, with a near plane of 0.01 units: share of the picture's light
              paths that end in Gaussians nearer than a tenth of the way that is left (0: clear, 1: fog)
    light     mean of that picture over the mean of what the camera filmed (near 0: black)

Writes OUT/splits.csv and OUT/half-way.png, and prints a line for each camera and split. The gap of a split is its
training PSNR less the held-out one, both matched.
"""

from __future__ import annotations

import argparse
import csv
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import numpy as np
from numpy.typing import NDArray

from airgs_codec.cli.common import parse_frames
from airgs_codec.errors import AirgsError, ConfigError
from airgs_codec.media.image import contact_sheet, to_bytes, write_png
from airgs_codec.media.metrics import mse, psnr
from airgs_codec.render import Camera, cpu, read_cameras
from airgs_codec.scene.camera import BLACK, NEAR
from airgs_codec.scene.gaussians import SH_C0, Gaussians
from airgs_codec.train.data.multiview import MultiviewScene, with_held_out, with_near
from airgs_codec.train.data.pictures import Pictures, View, pictures_for
from airgs_codec.train.data.readers import open_scene
from airgs_codec.train.fit.points import looked_at
from airgs_codec.train.record import Model, read_model
from airgs_codec.train.settings import settings_from_table

SEED = 1  # of the order in which cameras are dealt out
WAY = 0.5  # to the middle of the scene
NEAR_SHARE = 0.1  # of the way that is left: what is nearer than this there is fog


@dataclass(frozen=True, slots=True)
class Row:
    """A held-out camera of one split."""

    split: int
    camera: str
    psnr: float
    matched: float
    haze: float
    light: float


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """A split: its cameras, its training views, and what is seen half-way from each of its cameras."""

    rows: list[Row]
    training: float  # dB, matched
    half_way: list[NDArray[np.uint8]]  # a picture for each of the rows


def main(argv: Sequence[str] | None = None) -> int:
    """Train, judge and print; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--splits", type=int, default=4)
    parser.add_argument("--hold", type=int, default=4)
    parser.add_argument("--only", help="numbers of the splits to do, with commas (default: all)")
    parser.add_argument("--frames", help="as airgs-train has it")
    given = list(sys.argv[1:] if argv is None else argv)
    end = given.index("--") if "--" in given else len(given)
    args = parser.parse_args(given[:end])
    try:
        run(args, [*given[end + 1 :], *(["--frames", args.frames] if args.frames else [])])
    except AirgsError as error:
        print(f"bench_splits: {error}", file=sys.stderr)
        return 2
    return 0


def run(args: argparse.Namespace, options: Sequence[str]) -> None:
    """All splits one after the other. Raises ConfigError for splits that the scene has no cameras for."""
    names = [camera.name for camera in open_scene(args.scene).cameras]
    if args.splits * args.hold > len(names) or args.hold < 1:
        raise ConfigError(f"{args.scene}: {args.splits} splits of {args.hold} need more than its {len(names)} cameras")
    order = np.random.default_rng(SEED).permutation(len(names))
    numbers = range(args.splits) if args.only is None else [int(text) for text in args.only.split(",")]
    judged = []
    for number in numbers:
        held_out = [names[i] for i in order[number * args.hold : (number + 1) * args.hold]]
        folder = args.output / f"split-{number}"
        train(args.scene, folder, held_out, options)
        scene = with_held_out(open_scene(args.scene, frames=parse_frames(args.frames)), held_out)
        judged.append(judge(number, scene, folder))
        report(judged, args.output)


def train(scene: Path, folder: Path, held_out: Sequence[str], options: Sequence[str]) -> None:
    """`airgs-train` with these options. Raises ConfigError when it fails."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    program = [sys.executable, "-c", "import sys; from airgs_codec.cli.train import main; sys.exit(main())"]
    named = ["-o", str(folder), "--hold-out", ",".join(held_out), "--resume", *options]
    if subprocess.run([*program, str(scene), *named], check=False, stdout=subprocess.DEVNULL).returncode:
        raise ConfigError(f"{folder}: airgs-train failed")


def judge(number: int, scene: MultiviewScene, folder: Path) -> Judged:
    """A trained split by the cameras that it has not seen."""
    model = read_model(folder)
    pictures = open_pictures(scene, model)
    frames = range(len(model.record.frames))
    shown = [model.read(frame) for frame in frames]
    views = [pictures.held_out(frame) for frame in frames]
    cameras = [view.camera for view in (*pictures.train(0), *pictures.held_out(0))]
    middle = looked_at(cameras)
    rows, half_way = [], []
    for i, name in enumerate(view.camera.name for view in views[0]):
        plain, matched = compare(shown, [of_frame[i] for of_frame in views])
        picture, haze = from_half_way(shown[0], views[0][i].camera, middle)
        light = float(picture.mean() / views[0][i].target.rgb.mean())
        rows.append(Row(number, name, plain, matched, haze, light))
        half_way.append(to_bytes(picture))
    every = [pictures.train(frame) for frame in frames]
    training = [compare(shown, [of_frame[i] for of_frame in every])[1] for i in range(len(every[0]))]
    return Judged(rows, float(np.mean(training)), half_way)


def open_pictures(scene: MultiviewScene, model: Model) -> Pictures:
    """The pictures that a model was trained on, and those of its held-out cameras, in the look of the model."""
    settings = settings_from_table(model.record.settings)
    near = min(camera.near for camera in read_cameras(model.folder))
    pictures = pictures_for(with_near(scene, near), settings)
    return pictures.with_exposure(model.record.exposure) if model.record.exposure else pictures


def compare(shown: Sequence[Gaussians], views: Sequence[View]) -> tuple[float, float]:
    """PSNR in dB of one camera, mean over frames: as it is, and with the gain and offset that fit all frames best."""
    pairs = [
        (cpu.render(g, view.camera).rgb.reshape(-1, 3), view.target.rgb.reshape(-1, 3))
        for g, view in zip(shown, views, strict=True)
    ]
    plain = float(np.mean([psnr(mse(a, b)) for a, b in pairs]))
    matched = [np.empty_like(a) for a, _ in pairs]
    for channel in range(3):
        x = np.concatenate([a[:, channel] for a, _ in pairs]).astype(np.float64)
        y = np.concatenate([b[:, channel] for _, b in pairs]).astype(np.float64)
        gain, offset = np.polyfit(x, y, 1)
        for (a, _), out in zip(pairs, matched, strict=True):
            out[:, channel] = gain * a[:, channel] + offset
    return plain, float(np.mean([psnr(mse(m, b)) for m, (_, b) in zip(matched, pairs, strict=True)]))


def from_half_way(g: Gaussians, camera: Camera, middle: NDArray[np.float64]) -> tuple[NDArray[np.float32], float]:
    """The picture (H, W, 3) that the camera would see half-way to the middle, and the haze in it."""
    step = WAY * (middle - camera.position)
    view = camera.world_to_camera.copy()
    view[:3, 3] -= view[:3, :3] @ step
    moved = replace(camera, world_to_camera=view, near=NEAR)
    near = np.linalg.norm(g.means - (camera.position + step), axis=1) < NEAR_SHARE * np.linalg.norm(step)
    white = np.where(near, 0.5, -0.5).astype(np.float32) / np.float32(SH_C0)
    marked = replace(g.with_degree(0), sh_dc=np.repeat(white[:, None], 3, axis=1))
    haze = float(cpu.render(marked, replace(moved, background=BLACK)).rgb.mean())
    return np.clip(cpu.render(g, moved).rgb, 0, 1), haze


def report(judged: Sequence[Judged], folder: Path) -> None:
    """Print the last split and the means so far; write the table and the pictures."""
    last = judged[-1]
    for row in last.rows:
        print(f"{row.split} {row.camera}: {row.psnr:.2f} dB, matched {row.matched:.2f}, haze {row.haze:.3f}, "
              f"light {row.light:.2f}")  # fmt: skip
    rows = [row for split in judged for row in split.rows]
    mean, matched = (float(np.mean([getattr(row, name) for row in rows])) for name in ("psnr", "matched"))
    gap = float(np.mean([split.training for split in judged])) - matched
    worst = min(row.matched for row in rows)
    print(f"splits {len(judged)}: {mean:.2f} dB, matched {matched:.2f} (worst camera {worst:.2f}), gap {gap:.2f}, "
          f"most haze {max(row.haze for row in rows):.3f}", flush=True)  # fmt: skip
    with (folder / "splits.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, [f.name for f in fields(Row)])
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)
    captions = [f"split {row.split} {row.camera}, haze {row.haze:.3f}" for row in rows]
    write_png(folder / "half-way.png", contact_sheet([p for split in judged for p in split.half_way], captions))


if __name__ == "__main__":
    sys.exit(main())
