"""Do packages have the quality that they claim? Every rung measured again where no decision of the encoder looked.

Each scene is encoded with `--target-psnr` for each target. For every rung the PSNR that the package claims stands
beside that of pictures from views drawn anew from its viewing region, one for each picture, which take turns with the
frames, errors pooled as in a package.
Errors are heavy-tailed: one view close to a large Gaussian may outweigh a hundred. The packages stay in the folder.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from airgs_codec import encode, open_package, open_sequence
from airgs_codec.encoder.target import PSNR, Goal
from airgs_codec.errors import AirgsError
from airgs_codec.inspect.compare import compare_streams, frames_of, rung_streams
from airgs_codec.inspect.summary import rung_rows
from airgs_codec.media.metrics import Picture, psnr
from airgs_codec.package.package import Package
from airgs_codec.package.region import draw_views
from airgs_codec.render import Camera
from airgs_codec.scene.sequence import GaussianSequence
from tools.lab import Lab, Page, Row, Section, Table, required, setting
from tools.lab.made import name_of

SEED = 1000  # of the views that measure
DEFAULT = "default"  # in place of a target: the encoder's own quality
COLUMNS = {
    "scene": ("scene", ""), "target": ("target, dB", ""), "kilobytes": ("top rung, kB a frame", ".1f"),
    "claimed": ("claimed, dB", ".1f"), "measured": ("found", ".1f"),
    "low_kilobytes": ("lowest rung, kB a frame", ".1f"), "low_measured": ("its dB", ".1f"),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Options:
    scenes: tuple[str, ...] = required("scenes, each with its cameras or without: SCENE[=VIEWS]")
    targets: tuple[str, ...] = setting(("36", "40", "43"), f"dB, or {DEFAULT} for no target")
    pictures: int = setting(64, "pictures that measure a rung, each of its own view")


def run(options: Options, lab: Lab) -> Page:
    rows: list[Row] = []
    for spec in options.scenes:
        scene, _, cameras = spec.partition("=")
        sequence = open_sequence(scene, views=cameras or None)
        for target in options.targets:
            goal = None if target == DEFAULT else Goal(PSNR, float(target))
            folder = lab.folder / f"{name_of(spec)}-{target}.airgs"
            try:
                encode(sequence, folder, goal=goal)
            except AirgsError as error:
                lab.tell(f"{name_of(spec)} {target}: {error}")
                continue
            package = open_package(folder)
            seen = draw_views(package.manifest.region, options.pictures, SEED)
            rows += rows_of(name_of(spec), target, package, measure(package, sequence, seen, options.pictures))
    names = dict.fromkeys((row["scene"], row["target"]) for row in rows)
    packages = [package_row([row for row in rows if (row["scene"], row["target"]) == name]) for name in names]
    tables = [Table("claims-shown", [row for row in packages if row["target"] == options.targets[-1]], COLUMNS)]
    data = [Table("claims-packages", packages, COLUMNS), Table("claims", rows)]
    how = (
        f"Each rung is measured in {options.pictures} pictures from views drawn anew from the package's region; bytes "
        "are all that a viewer fetches."
    )
    return Page([Section("", tables=tables)], how, data=data)


def measure(
    package: Package, sequence: GaussianSequence, cameras: Sequence[Camera], pictures: int
) -> dict[str, list[float]]:
    """Squared errors of every rung in so many pictures, or a few more: evenly spaced frames, cameras in turn."""
    step = max(1, len(sequence) // pictures)
    frames = range((len(sequence) - 1) % step // 2, len(sequence), step)
    turn, each = itertools.cycle(cameras), -(-pictures // len(frames))
    views = [(number, camera) for number in frames for camera in itertools.islice(turn, each)]
    return compare_streams(rung_streams(package, frames), frames_of(sequence, frames), views, Picture.mse)


def rows_of(scene: str, target: str, package: Package, found: Mapping[str, Sequence[float]]) -> list[Row]:
    """A row for each rung of a package, by falling bytes: what it claims and what was found; `off`: how much more."""
    rows, frames = [], package.manifest.frames
    for rung in sorted(rung_rows(package.manifest, package.manifest_bytes), key=lambda r: -r["bytes_per_frame"]):
        errors = found[name := f"{rung['keyframe']}+{rung['delta']}"]
        measured, claimed = round(psnr(sum(errors) / len(errors)), 3), rung["psnr"]
        rows.append(
            {"scene": scene, "target": target, "rung": name, "kilobytes": rung["bytes_per_frame"] / 1e3}
            | {"manifests": package.manifest_bytes / frames / 1e3, "claimed": claimed}
            | {"measured": measured, "ladder": rung["best"]}
            | {"off": 0.0 if claimed is None else round(measured - claimed, 3)}
        )
    return rows


def package_row(rows: Sequence[Row]) -> Row:
    """What people look at of a package: its top rung, the lowest of its ladder, how far the ladder's claims are off."""
    top, ladder = rows[0], [row for row in rows if row["ladder"]]
    low = ladder[-1] if ladder else top
    kept = ("scene", "target", "kilobytes", "claimed", "measured")
    cheaper = {  # rungs with fewer bytes that were measured to be at least as good
        row["rung"]: [o for o in rows if o["kilobytes"] < row["kilobytes"] and o["measured"] >= row["measured"]]
        for row in ladder
    }
    return {name: top[name] for name in kept} | {
        "low_kilobytes": low["kilobytes"],
        "low_measured": low["measured"],
        "off": max((row["off"] for row in ladder), key=abs, default=0.0),
        "beaten": " ".join(name for name, others in cheaper.items() if others),
    }
