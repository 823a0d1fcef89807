"""The scenes that experiments measure: their frames and cameras, what a frame takes, and what packages do without.

Bytes of files are those of the first, middle and last frame in each format, those of a package what a viewer of its top
rung fetches. What is left out stands in the tables of a package: `alone_db` is the PSNR that leaving it out has by
itself, of the group that it costs most.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from airgs_codec import open_package, open_sequence
from airgs_codec._sampling import evenly_spaced
from airgs_codec.media.metrics import psnr
from airgs_codec.package.package import Package
from airgs_codec.scene.formats.table import write
from airgs_codec.scene.sequence import GaussianSequence
from tools.lab import Lab, Page, Row, Section, Table, required
from tools.lab.made import encoded, name_of

FORMS = ("ply", "spz", "sog")
WHAT = {"gaussians": "Gaussians that nobody sees", "updates": "updates of Gaussians that rest"}  # the others' own names
COLUMNS = {
    "scene": ("scene", ""), "frames": ("frames", ""), "Gaussians": ("Gaussians", ",d"), "SH": ("SH degree", ""),
    **{f"{form}_kb": (f".{form}, kB a frame", ",.0f") for form in FORMS},
    "airgs_kb": ("airgs, kB a frame", ".1f"), "psnr": ("its PSNR, dB", ".1f"),
}  # fmt: skip
LEFT_OUT = {
    "scene": ("scene", ""), "what": ("left out", ""), "count": ("how many, at most", ",d"), "of": ("of", ",d"),
    "kb": ("saved, kB a frame", ".2f"), "package_kb": ("package, kB a frame", ".1f"),
    "alone_db": ("PSNR of this change alone, dB", ".1f"),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Options:
    scenes: tuple[str, ...] = required("scenes, SCENE[=CAMERAS]")


def run(options: Options, lab: Lab) -> Page:
    rows, left_out = list[Row](), list[Row]()
    for scene in options.scenes:
        place, _, views = scene.partition("=")
        sequence, package = open_sequence(place, views=views or None), open_package(encoded(scene, lab.folder))
        rows.append({"scene": name_of(scene)} | row_of(sequence, package))
        left_out += [{"scene": name_of(scene)} | row for row in left_out_of(package)]
        lab.tell(f"{rows[-1]}")
    return Page([Section("", tables=[Table("scenes", rows, COLUMNS)])], data=[Table("left-out", left_out, LEFT_OUT)])


def row_of(sequence: GaussianSequence, package: Package) -> Row:
    counts, cameras = [header.count for header in sequence.headers], sequence.cameras
    sizes = {f"{c.width} x {c.height}" for c in cameras}
    row: Row = {
        "frames": len(counts), "fps": float(sequence.fps), "Gaussians": max(counts), "SH": sequence.sh_degree,
        "cameras": len(cameras), "held out": sum(c.held_out for c in cameras), "pictures": ", ".join(sorted(sizes)),
    }  # fmt: skip
    frames = [sequence.read(number) for number in evenly_spaced(len(counts), min(3, len(counts)))]
    with TemporaryDirectory() as folder:
        for form in FORMS:
            for number, g in enumerate(frames):
                write(g, Path(folder) / f"{number}.{form}")
            row[f"{form}_kb"] = np.mean([p.stat().st_size for p in Path(folder).glob(f"*.{form}")]).item() / 1e3
    return row | {"airgs_kb": _top_kb(package), "psnr": package.rungs[0].psnr}


def _top_kb(package: Package) -> float:
    return package.rungs[0].bytes / package.manifest.frames / 1e3


def left_out_of(package: Package) -> Iterator[Row]:
    m = package.manifest
    entries = [entry for group in m.groups for entry in group.left_out]
    counts = {
        "gaussians": max(group.count + group.unused for group in m.groups), "updates": max(g.count for g in m.groups)
    }  # fmt: skip
    for what in dict.fromkeys(entry.what for entry in entries):
        some = [entry for entry in entries if entry.what == what]
        error = max(entry.error for entry in some)
        yield {
            "what": WHAT.get(what, what), "groups": len(some), "count": max(entry.count for entry in some),
            "of": counts.get(what), "kb": sum(entry.bytes for entry in some) / len(m.groups) / 1e3,
            "package_kb": _top_kb(package), "alone_db": psnr(error) if error > 0 else None,
        }  # fmt: skip
