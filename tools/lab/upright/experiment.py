"""How often viewers begin upright where nobody tells which way is up: scenes as they come, and turned at random.

A scene is SCENE=UP, with what is up in it; in a .glb that is y. Each is turned by one after another of the 24 turns
that map axes to axes, and tilted at random; and as often by turns of which each is as likely as any other. Of a model
another animation is shown every time, but for those in which it lies down. A first view is upright where up is within
25 degrees of that of the picture. "held back" are those by whom no weight was chosen.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from airgs_codec._sampling import evenly_spaced
from airgs_codec.analysis.viewpoints import find_viewpoints
from airgs_codec.package.region import parse_up
from airgs_codec.scene.frames import repair
from airgs_codec.scene.gaussians import Gaussians, multiply
from airgs_codec.scene.sequence import open_sequence
from tools.lab import Lab, Page, Row, Section, Table, required, setting
from tools.lab.upright.models import Model

FRAMES = 3
ROWS = 8000  # of a model
RIGHT = np.cos(np.radians(25))
LYING = re.compile("death|dead|die|lie|lying", re.IGNORECASE)
COLUMNS = {
    "scene": ("scene", ""), "kind": ("weights", ""), "comes": ("as it comes", ""),
    "quarters": ("turned from axis to axis", ".0%"), "turned": ("turned anyhow", ".0%"),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Options:
    scenes: tuple[str, ...] = required("SCENE=UP, such as head/=y, or .glb models")
    held: tuple[str, ...] = setting((), "names of those by whom no weight was chosen")
    turns: int = setting(24, "of each kind")
    tilt: float = setting(5.0, "degrees, standard deviation about each axis")


def run(options: Options, lab: Lab) -> Page:
    rows = [measure(scene, options) for scene in options.scenes]
    answer = " ".join(share for kind in ("tuned", "held back") if (share := _words(rows, kind)))
    return Page([Section(answer, tables=[Table("upright", rows, COLUMNS)])])


def measure(scene: str, options: Options) -> Row:
    place, _, told = scene.partition("=")
    up, name, rng = np.array(parse_up(told or "y"), np.float64), Path(place).stem, np.random.default_rng(0)
    shown = _moments(Path(place), rng) if place.endswith(".glb") else _always(_frames(place))
    quarters = list(Rotation.create_group("O"))
    right: dict[str, list[bool]] = {"quarters": [], "turned": []}
    for i in range(options.turns):
        tilt = Rotation.from_rotvec(rng.normal(0, np.radians(options.tilt), 3))
        turns = {"quarters": tilt * quarters[i % len(quarters)], "turned": Rotation.random(random_state=i)}
        for how, turn in turns.items():
            right[how].append(is_upright([turned(frame, turn) for frame in next(shown)], turn.apply(up)))
    comes = "upright" if is_upright(next(shown), up) else "not"
    kind = "held back" if name in options.held else "tuned"
    shares = {how: float(np.mean(found)) for how, found in right.items()}
    return {"scene": name, "kind": kind, "comes": comes, "count": options.turns, **shares}


def is_upright(frames: Sequence[Gaussians], up: NDArray[np.float64]) -> bool:
    """Whether `up` (3,) points up in the picture that viewers of these frames begin at."""
    first = find_viewpoints(frames).cameras[0]
    return float(-first.world_to_camera[1, :3] @ up) > RIGHT


def turned(gaussians: Gaussians, turn: Rotation) -> Gaussians:
    quaternions = multiply(np.roll(turn.as_quat(), 1), gaussians.quaternions.astype(np.float64))
    means = gaussians.means @ turn.as_matrix().T
    return replace(gaussians.with_degree(0), means=means.astype(np.float32), quaternions=quaternions.astype(np.float32))


def _words(rows: Sequence[Row], kind: str) -> str:
    of = [row for row in rows if row["kind"] == kind]
    if not of:
        return ""
    comes = sum(row["comes"] == "upright" for row in of)
    quarters, turned = (np.mean([row[how] for row in of]) for how in ("quarters", "turned"))
    return f"{kind}: {comes} of {len(of)} upright as they come, {quarters:.0%} turned by quarters, {turned:.0%} anyhow."


def _frames(place: str) -> list[Gaussians]:
    sequence = open_sequence(place)
    return [repair([sequence.read(i)], place).frames[0] for i in evenly_spaced(len(sequence), FRAMES)]


def _always(frames: list[Gaussians]) -> Iterator[list[Gaussians]]:
    while True:
        yield frames


def _moments(path: Path, rng: np.random.Generator) -> Iterator[list[Gaussians]]:
    model = Model.of(path)
    named = enumerate(model.document.get("animations", []))
    standing = [i for i, animation in named if not LYING.search(animation.get("name") or "")]
    while True:
        animation = standing[int(rng.integers(len(standing)))] if standing else None
        times: NDArray[np.float64] = np.sort(rng.uniform(0, 1, FRAMES))
        yield [model.frame(animation, moment, ROWS) for moment in times]
