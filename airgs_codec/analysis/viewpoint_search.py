"""Looking for good places to see a scene from: at random, then about the best of each neighbourhood.

A pose is (position (3,), direction (3,) of length 1), world units.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec.analysis.viewpoint_score import Look, Sample
from airgs_codec.scene.camera import Camera, look_at
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.orbits import UP
from airgs_codec.scene.rotations import from_rotation_vector, to_matrices

Vector = NDArray[np.float64]

FIELD_OF_VIEW = np.radians(60)  # of both axes
SIZE = 32  # pixels
COARSE_ROWS, FINE_ROWS = 1000, 4000
PARENTS = 12  # neighbourhoods that a round looks about
CHILDREN = 3  # poses tried about the best of each, and one on the other side of what it sees
STEP = 0.25  # of the distance to what is seen, and radians; the first round's
WALK = np.radians(30)  # standard deviation of a turn about what is seen, by each axis
SHRINK = 0.75  # of the step, from round to round
TURN = np.radians(35)  # is as far as half the distance to what is seen
NOTHING = Look(0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """A place, a direction, and what is seen."""

    position: Vector  # (3,) world units
    direction: Vector  # (3,) of length 1
    look: Look = NOTHING

    @staticmethod
    def tried(sample: Sample, position: Vector, direction: Vector) -> Pose:
        """What is seen of a sample from `position` along `direction`, of any length."""
        pose = Pose(position, unit(direction))
        return replace(pose, look=sample.look(pose.camera("tried", SIZE)))

    def camera(self, name: str, size: int, up: Vector = UP) -> Camera:
        """A square camera of `size` pixels here; roll, which `up` decides, hardly matters to a score."""
        return look_at(self.position, self.position + self.direction, up, size=size, fov_y=FIELD_OF_VIEW, name=name)


class Search:
    """Poses tried so far; seeded, so that the same scene gives the same poses."""

    def __init__(self, gaussians: Gaussians, seed: int = 0) -> None:
        """`gaussians` are repaired. Raises SceneError when no row can be seen."""
        self._coarse, self._fine = (Sample.of(gaussians, rows) for rows in (COARSE_ROWS, FINE_ROWS))
        self._rng = np.random.default_rng(seed)
        self._means = self._fine.inputs.means.astype(np.float64)
        self._low, self._high = np.quantile(self._means, [0.05, 0.95], axis=0)
        self.poses: list[Pose] = []

    def scatter(self, count: int, kept: int) -> None:
        """Try poses at random: half of them anywhere in the box of the scene, half about something to see.

        The best `kept` of them, as few rows tell, are looked at again with more.
        """
        extent, tried = float((self._high - self._low).max()), []
        for i in range(count):
            target = self._means[self._rng.integers(len(self._means))]
            if i % 2:
                margin = 0.5 * (self._high - self._low)
                place = self._rng.uniform(self._low - margin, self._high + margin)
            else:
                away = extent * 10 ** self._rng.uniform(-1, 0.2)
                place = target + away * unit(self._rng.normal(size=3))
            tried.append(Pose.tried(self._coarse, place, target - place))
        for pose in best_apart(tried, kept):
            self._try(pose.position, pose.direction)

    def refine(self, rounds: int) -> None:
        """Try poses about the best of the best neighbourhoods, closer from round to round."""
        for step in STEP * SHRINK ** np.arange(rounds):
            for parent in best_apart(self.poses, PARENTS):
                for _ in range(CHILDREN):
                    shift = self._rng.normal(0, step * parent.look.distance, 3)
                    self._try(parent.position + shift, parent.direction + self._rng.normal(0, step, 3))
                self._walk_about(parent)

    def _walk_about(self, parent: Pose) -> None:
        """Try what the parent sees from another side: rings of cameras are found by walking round."""
        turn = to_matrices(from_rotation_vector(self._rng.normal(0, WALK, 3)))
        seen = parent.position + parent.look.distance * parent.direction
        self._try(seen + turn @ (parent.position - seen), turn @ parent.direction)

    def _try(self, position: Vector, direction: Vector) -> None:
        self.poses.append(Pose.tried(self._fine, position, direction))


def unit(vector: Vector) -> Vector:
    """The vector at length 1; one of length 0 becomes the z axis."""
    length = np.linalg.norm(vector)
    return vector / length if length > 0 else np.array([0.0, 0.0, 1.0])


def gaps(poses: Sequence[Pose]) -> NDArray[np.float64]:
    """(P, P) how far poses are apart: 1 for TURN, or for half the distance to what is seen."""
    positions, directions = np.stack([p.position for p in poses]), np.stack([p.direction for p in poses])
    away = np.array([p.look.distance for p in poses])
    moves = np.linalg.norm(positions[:, None] - positions[None], axis=2) / (0.5 * np.minimum(away[:, None], away[None]))
    turns = np.arccos(np.clip(directions @ directions.T, -1, 1)) / TURN
    return np.hypot(moves, turns)


def best_apart(poses: Sequence[Pose], count: int, gap: float = 1.0) -> list[Pose]:
    """At most `count` poses, best first, no two of them closer than `gap`."""
    ranked = sorted(poses, key=lambda p: -p.look.score)
    apart, free = gaps(ranked) >= gap, np.ones(len(ranked), bool)
    chosen: list[Pose] = []
    for i, pose in enumerate(ranked):
        if free[i] and len(chosen) < count:
            chosen.append(pose)
            free &= apart[i]
    return chosen


def spread(poses: Sequence[Pose], count: int) -> list[Pose]:
    """At most `count` of the poses, the first among them, each as far as can be from those before it."""
    between = gaps(poses)
    chosen = [0]
    while len(chosen) < min(count, len(poses)):
        chosen.append(int(np.argmax(between[chosen].min(axis=0))))
    return [poses[i] for i in chosen]


def judge(poses: Sequence[Pose], frames: Sequence[Gaussians]) -> list[Pose]:
    """The poses, best first, with what other samples of all frames say about them on average."""
    looks = []
    for frame in frames:
        sample = Sample.of(frame, FINE_ROWS, seed=1)
        looks.append([sample.look(pose.camera("judged", SIZE)) for pose in poses])
    means = [Look.mean(of_pose) for of_pose in zip(*looks, strict=True)]
    return sorted((replace(p, look=m) for p, m in zip(poses, means, strict=True)), key=lambda p: -p.look.score)
