"""Looks for the viewpoints of each scene, a folder of .ply frames, in its first, middle and last frame.

Where true cameras are given, each camera of one rig is compared with the nearest of the other, both ways: the distance
between them in distances to what is seen, and the angle; medians and worst. Seconds are of the processor, on one
thread; kernels are compiled before, if they have to be. A contact sheet of each scene goes to the folder.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from airgs_codec._sampling import evenly_spaced
from airgs_codec.analysis.viewpoint_score import Sample
from airgs_codec.analysis.viewpoints import find_viewpoints
from airgs_codec.inspect.compare import write_contact_sheet
from airgs_codec.render import Camera, look_at, read_cameras, render
from airgs_codec.scene.sequence import open_sequence
from tools.lab import Lab, Page, Row, Section, Table, required, seconds_of

FRAMES = 3
ROWS = 4000  # that tell how far away is what a camera sees
HALF = 35.0  # degrees that are as far as half the distance to what is seen
WARM = look_at(np.zeros(3), np.ones(3), np.array([0.0, 1.0, 0.0]), size=32, fov_y=1.0, name="warm")


@dataclass(frozen=True, slots=True)
class Options:
    """What is looked at."""

    scenes: tuple[str, ...] = required("scenes, each with its true cameras where they are known: SCENE[=CAMERAS]")


def run(options: Options, lab: Lab) -> Page:
    """A row for each scene."""
    render(open_sequence(options.scenes[0].partition("=")[0]).load([0]).frames[0], WARM)
    measured = [measure(scene, lab.folder) for scene in options.scenes]
    answer = " ".join(f"{row['scene']}: {story}" for row, story in measured)
    table = Table("viewpoints", [row for row, _ in measured])
    return Page([Section(answer, tables=[table])])


def measure(scene: str, folder: Path) -> tuple[Row, str]:
    """The row of one SCENE[=CAMERAS], and the story of what was found."""
    place, _, cameras = scene.partition("=")
    sequence = open_sequence(place)
    frames = [sequence.read(i) for i in evenly_spaced(len(sequence), FRAMES)]
    took, found = seconds_of(lambda: find_viewpoints(frames))
    middle = sequence.load([len(sequence) // 2]).frames[0]
    name = Path(place).resolve().name
    row = {"scene": name, "Gaussians": len(middle), "CPU s": took.cpu, "sure": found.confident}
    if cameras:
        rig, sample = read_cameras(Path(cameras)), Sample.of(middle, ROWS)
        pairs = compare(rig, found.cameras, sample) + compare(found.cameras, rig, sample)
        row |= dict(zip(("true to found", "found, worst", "found to true", "true, worst"), pairs, strict=True))
    write_contact_sheet(folder / f"{name}.png", middle, found.cameras, [f"{score:.2f}" for score in found.scores])
    return row, found.story


def compare(rig: Sequence[Camera], other: Sequence[Camera], sample: Sample) -> list[str]:
    """Median and worst of what lies between the cameras of a rig and the nearest of another."""
    pairs = np.array([_nearest(camera, other, sample.look(camera).distance) for camera in rig])
    return [f"{away:.2f}, {angle:.0f} deg" for away, angle in (np.median(pairs, axis=0), pairs.max(axis=0))]


def _nearest(camera: Camera, rig: Sequence[Camera], away: float) -> tuple[float, float]:
    """Distance, in units of `away`, and degrees from a camera to the nearest of a rig."""
    shifts = [float(np.linalg.norm(camera.position - other.position)) / away for other in rig]
    cosines = [camera.world_to_camera[2, :3] @ other.world_to_camera[2, :3] for other in rig]
    turns = np.degrees(np.arccos(np.clip(cosines, -1, 1)))
    return min(zip(shifts, turns.tolist(), strict=True), key=lambda pair: np.hypot(2 * pair[0], pair[1] / HALF))
