"""How near found viewpoints are to the true cameras of scenes that come with them, and what is said of scenes without.

Viewpoints are found in the first, middle and last frame of each scene. Each true camera is compared with the nearest
that was found: the distance between them, in distances to what the true one sees, and the angle.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from airgs_codec._sampling import evenly_spaced
from airgs_codec.analysis.viewpoints import Sample, find_viewpoints
from airgs_codec.render import Camera, read_cameras
from airgs_codec.scene.sequence import open_sequence
from tools.lab import Lab, Page, Row, Section, Table, required
from tools.lab.made import name_of

FRAMES = 3
ROWS = 4000  # that tell how far away is what a camera sees
HALF = 35.0  # degrees that are as far as half the distance to what is seen
COLUMNS = {
    "scene": ("scene", ""), "story": ("answer", ""), "sure": ("sure", ""),
    "away": ("apart, median", ".2f"), "degrees": ("degrees", ".0f"),
    "most_away": ("apart, most", ".2f"), "most_degrees": ("degrees", ".0f"),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Options:
    scenes: tuple[str, ...] = required("scenes, each with its true cameras where they are known: SCENE[=CAMERAS]")


def run(options: Options, lab: Lab) -> Page:
    rows = [measure(scene) for scene in options.scenes]
    return Page([Section("", tables=[Table("viewpoints", rows, COLUMNS)])])


def measure(scene: str) -> Row:
    place, _, cameras = scene.partition("=")
    sequence = open_sequence(place)
    found = find_viewpoints([sequence.read(i) for i in evenly_spaced(len(sequence), FRAMES)])
    middle = sequence.load([len(sequence) // 2]).frames[0]
    row = {"scene": name_of(scene), "sure": found.confident, "story": re.split(r":| \(", found.summary)[0]}
    if cameras:
        row |= compare(read_cameras(Path(cameras)), found.cameras, Sample.of(middle, ROWS))
    return row


def compare(rig: Sequence[Camera], found: Sequence[Camera], sample: Sample) -> Row:
    """Medians and most of what lies between the cameras of a rig and the nearest found ones."""
    pairs = np.array([_nearest(camera, found, sample.look(camera)[1]) for camera in rig])
    middle, most = np.median(pairs, axis=0).tolist(), pairs.max(axis=0).tolist()
    return dict(zip(("away", "degrees", "most_away", "most_degrees"), [*middle, *most], strict=True))


def _nearest(camera: Camera, rig: Sequence[Camera], away: float) -> tuple[float, float]:
    """Distance, in units of `away`, and degrees from a camera to the nearest of a rig."""
    shifts = [float(np.linalg.norm(camera.position - other.position)) / away for other in rig]
    cosines = [camera.world_to_camera[2, :3] @ other.world_to_camera[2, :3] for other in rig]
    turns = np.degrees(np.arccos(np.clip(cosines, -1, 1)))
    return min(zip(shifts, turns.tolist(), strict=True), key=lambda pair: np.hypot(2 * pair[0], pair[1] / HALF))
