"""Training methods side by side on one scene: quality, bytes and seconds.

    python -m tools.bench_train SCENE -o OUT [--methods airgs,v3,naive3dgs] [--frames A:B] [--max-size PX]

Every method trains with the default settings into OUT/METHOD, is encoded as `airgs-encode` does by default, decoded,
and compared with the pictures of the held-out cameras. Writes OUT/methods.csv and prints it. psnr and package_psnr are
means over frames and views of each view's PSNR in dB; worst_frame is the lowest mean over views.
"""

from __future__ import annotations

import argparse
import csv
import os
import time
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import numpy as np

from airgs_codec.cli.common import parse_frames
from airgs_codec.decoder.decode import decode
from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.package.paths import JSON_NAME, MPD_NAME
from airgs_codec.package.store import open_package
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.sequence import open_sequence
from airgs_codec.train.data.multiview import MultiviewScene, with_held_out
from airgs_codec.train.data.pictures import Pictures, pictures_for
from airgs_codec.train.data.readers import open_scene
from airgs_codec.train.quality import mean_psnr, mean_ssim
from airgs_codec.train.run import train
from airgs_codec.train.settings import METHODS, TrainSettings

COLUMNS = (
    "method",
    "frames",
    "groups",
    "gaussians",
    "psnr",
    "worst_frame",
    "ssim",
    "ply_kb_frame",
    "package_kb_frame",
    "package_psnr",
    "train_s_frame",
    "encode_s",
)


def main() -> None:
    """Run the methods one after another."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--methods", default=",".join(METHODS))
    parser.add_argument("--frames")
    parser.add_argument("--max-size", type=int)
    args = parser.parse_args()
    scene = with_held_out(open_scene(args.scene, frames=parse_frames(args.frames)), None)
    args.output.mkdir(parents=True, exist_ok=True)
    rows = []
    for method in args.methods.split(","):
        settings = replace(TrainSettings(max_size=args.max_size), method=method)
        rows.append(measure(scene, settings, args.output / method))
        print(rows[-1], flush=True)
        with (args.output / "methods.csv").open("w", newline="") as file:
            writer = csv.DictWriter(file, COLUMNS)
            writer.writeheader()
            writer.writerows(rows)


def measure(scene: MultiviewScene, settings: TrainSettings, folder: Path) -> dict[str, object]:
    """One row of the table; a run that is there already is used."""
    model = train(scene, folder, settings, resume=True)
    records = model.record.frames
    pictures = pictures_for(scene, settings)
    target = folder.with_suffix(".airgs")
    begun = time.perf_counter()
    encode(open_sequence(folder), target, EncodeSettings(measure_pictures=0))
    encode_s = time.perf_counter() - begun
    package = open_package(target)
    manifest = package.manifest
    tables = sum((target / name).stat().st_size for name in (JSON_NAME, MPD_NAME))
    decoded = [compare(decode(package, t), pictures, t)[0] for t in range(len(scene))]
    trained = [compare(model.read(t), pictures, t) for t in range(len(scene))]
    return {
        "method": settings.method,
        "frames": len(records),
        "groups": len(model.record.keyframes()),
        "gaussians": round(float(np.mean([r.gaussians for r in records]))),
        "psnr": round(float(np.mean([p for p, _ in trained])), 2),
        "worst_frame": round(min(p for p, _ in trained), 2),
        "ssim": round(float(np.mean([s for _, s in trained])), 4),
        "ply_kb_frame": round(sum(p.stat().st_size for p in folder.glob("*.ply")) / len(records) / 1e3, 1),
        "package_kb_frame": round((manifest.bytes_of(manifest.rung_files(0, 0)) + tables) / len(records) / 1e3, 1),
        "package_psnr": round(float(np.mean(decoded)), 2),
        "train_s_frame": round(sum(r.seconds for r in records) / len(records), 1),
        "encode_s": round(encode_s, 1),
    }


def compare(g: Gaussians, pictures: Pictures, frame: int) -> tuple[float, float]:
    """Mean PSNR (dB) and SSIM over the held-out views of a frame."""
    views = pictures.held_out(frame)
    return mean_psnr(g, views), mean_ssim(g, views)


if __name__ == "__main__":
    main()
