"""The scenes that experiments measure: frames, Gaussians and cameras of each."""

from __future__ import annotations

from dataclasses import dataclass

from airgs_codec.scene.sequence import open_sequence
from tools.lab import Lab, Page, Row, Section, Table, required
from tools.lab.made import name_of


@dataclass(frozen=True, slots=True)
class Options:
    scenes: tuple[str, ...] = required("scenes, SCENE[=CAMERAS]")


def run(options: Options, lab: Lab) -> Page:
    rows = []
    for scene in options.scenes:
        rows.append(row_of(scene))
        lab.tell(f"{rows[-1]}")
    return Page([Section("", tables=[Table("scenes", rows)])])


def row_of(scene: str) -> Row:
    place, _, views = scene.partition("=")
    sequence = open_sequence(place, views=views or None)
    counts = [header.count for header in sequence.headers]
    held, sizes = [c for c in sequence.cameras if c.held_out], {f"{c.width} x {c.height}" for c in sequence.cameras}
    return {
        "scene": name_of(scene), "frames": len(counts), "fps": float(sequence.fps), "Gaussians": max(counts),
        "SH": sequence.sh_degree, "cameras": len(sequence.cameras), "held out": len(held),
        "pictures": ", ".join(sorted(sizes)),
    }  # fmt: skip
