"""Where a scene that comes without cameras is meant to be seen from.

Three answers. An object whose surroundings are empty is seen from all sides, or from above the floor it stands on. A
filmed place is seen from where pictures of it look like pictures (`viewpoint_score`), which a search finds: at random,
then about the best of each neighbourhood. Where neither is clear, the answer says so, and its cameras are the best
guesses and views from all sides. A pose is (position (3,), direction (3,) of length 1), world units.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from airgs_codec.analysis.up import Subject, find_front, guess_up, surfaces
from airgs_codec.analysis.viewpoint_score import Look, Sample
from airgs_codec.errors import SceneError
from airgs_codec.render.cpu import one_thread
from airgs_codec.scene.camera import UP, Camera, dome_views, look_at, orbit_views, side_view
from airgs_codec.scene.frames import repair
from airgs_codec.scene.gaussians import Gaussians, from_rotation_vector, to_matrices

Vector = NDArray[np.float64]

FIELD_OF_VIEW = np.radians(60)  # of both axes
TRIED_SIZE = 32  # pixels of a pose that is tried
COARSE_ROWS, FINE_ROWS = 1000, 4000
PARENTS = 12  # neighbourhoods that a round looks about
CHILDREN = 3  # poses tried about the best of each, and one on the other side of what it sees
STEP = 0.25  # of the distance to what is seen, and radians; the first round's
WALK = np.radians(30)  # standard deviation of a turn about what is seen, by each axis
SHRINK = 0.75  # of the step, from round to round
TURN = np.radians(35)  # is as far as half the distance to what is seen
NOTHING = Look(0.0, 0.0, 0.0, 1.0)

SIZE = 256  # pixels of the cameras
COUNT = 12  # cameras
GUESSES = 8  # cameras of either kind where nothing is sure; the fewest where it is
SIDES, SIDE_SIZE, SIDE_ROWS = 12, 48, 8000  # views, pixels and rows that tell an object from a place
OBJECT = 0.6  # solidity of three in four sides of an object; filmed places have up to 0.5, objects from 0.7
PERHAPS = 0.52  # solidity of what may be either
# Of views of an object, lowest and highest above the horizon: people walk around it, and look up or down a little.
AROUND, ON_FLOOR = np.radians([-20, 45]), np.radians([5, 60])
SCATTERED, KEPT, ROUNDS = 300, 40, 5  # poses tried at random, those looked at again, rounds about the best of them
GOOD = 0.7  # of the best score
APART = (0.35, 0.2, 0.1)  # of `gaps`, of the poses that cameras are chosen from: the first that leaves enough
REGION = 1.5  # of `gaps`, at most, from one pose of a region to the next
UPRIGHT = np.cos(np.radians(20))  # between the floor's own up and the one that is told
NOTHING_SEEN = "nothing can be seen: 8 views on an orbit"
GUESS = "up is guessed to be "  # how the line about it begins
RISE = np.radians(12)  # of the first view of an object, above the horizon
SURE = 0.05  # score of the best; real captures have 0.1 to 0.2, broken ones mostly up to 0.03
SURE_COVERED = 0.95  # of most pictures; who films a place fills them, objects with haze about them leave holes


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """A place, a direction, and what is seen."""

    position: Vector  # (3,) world units
    direction: Vector  # (3,) of length 1
    look: Look = NOTHING

    @staticmethod
    def tried(sample: Sample, position: Vector, direction: Vector) -> Pose:
        """Look at a sample from `position` along `direction`, of any length."""
        pose = Pose(position, unit(direction))
        return replace(pose, look=sample.look(pose.camera("tried", TRIED_SIZE)))

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

    def scatter(self, count: int, again: int) -> None:
        """Try poses at random: half of them anywhere in the box of the scene, half about something to see.

        The best of them, `again` many, as few rows tell, are looked at again with more.
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
        for pose in best_apart(tried, again):
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
        looks.append([sample.look(pose.camera("judged", TRIED_SIZE)) for pose in poses])
    means = [Look.mean(of_pose) for of_pose in zip(*looks, strict=True)]
    return sorted((replace(p, look=m) for p, m in zip(poses, means, strict=True)), key=lambda p: -p.look.score)


@dataclass(frozen=True, slots=True, eq=False)
class FoundViews:
    """Cameras that stand for all places from which a scene looks good."""

    cameras: list[Camera]
    scores: list[float]  # 0..1 for each camera: of `Look` for a place, solidity for an object, 0 of views all around
    confident: bool  # whether viewers stay near these cameras; else they may be anywhere
    story: str  # a line that says what was found, and how sure it is
    guess: str = ""  # one that says which way is up, where nobody told it


def find_viewpoints(frames: Sequence[Gaussians], up: Vector | None = None) -> FoundViews:
    """Find where some frames of a scene are meant to be seen from. The middle one decides, all of them judge.

    8 to 17 square cameras, first the one that viewers begin at; the same frames give the same cameras. `up` (3,) points
    up where somebody told it; else cues vote on it (`analysis.up`). A frame need not be repaired; frames need not share
    rows.

    Raises SceneError when a frame has no finite row.
    """
    usable = [repair([frame], "views").frames[0] for frame in frames]
    middle = usable[len(usable) // 2]
    try:
        with one_thread():
            solidity = _solidity(middle)
            found, upright = (_object if solidity >= OBJECT else _place)(usable, up, solidity)
    except SceneError:
        upright = UP if up is None else up
        found = FoundViews(orbit_views(middle, up=upright), [0.0] * 8, False, NOTHING_SEEN)
    if up is not None:
        return found
    x, y, z = upright.round(2) + 0.0
    return replace(found, guess=f"{GUESS}({x:g}, {y:g}, {z:g}); --up says otherwise")


def _solidity(gaussians: Gaussians) -> float:
    """Solidity that three in four views from all sides have. Raises SceneError when no row can be seen."""
    sample = Sample.of(gaussians, SIDE_ROWS)
    sides = [sample.solidity(camera) for camera in dome_views(gaussians, SIDES, SIDE_SIZE, UP)]
    return float(np.quantile(sides, 0.25))


def _object(frames: Sequence[Gaussians], up: Vector | None, _: float) -> tuple[FoundViews, Vector]:
    """From in front, then all around, or over what it stands on, where the floor's own up is about `up` (3,)."""
    middle, subject = frames[len(frames) // 2], Subject.of(frames)
    upright = guess_up(subject) if up is None else up / np.linalg.norm(up)
    stands = subject.floor is not None and float(subject.floor @ upright) > UPRIGHT
    low, high = ON_FLOOR if stands else AROUND
    around = dome_views(middle, COUNT, SIZE, upright, (low, high))
    cameras = [_front(subject, middle, upright), *around]
    sample = Sample.of(middle, SIDE_ROWS)
    scores = [sample.solidity(camera) for camera in cameras]
    degrees = (
        f"{np.degrees(low):.0f}° to {np.degrees(high):.0f}° above the horizon{', over its floor' if stands else ''}"
    )
    story = f"an object in empty space: a view from in front and {COUNT} around it, {degrees}"
    return FoundViews(cameras, scores, True, story), upright


def _front(subject: Subject, middle: Gaussians, up: Vector) -> Camera:
    side = np.cos(RISE) * find_front(subject, up) + np.sin(RISE) * up
    return side_view(middle, side, up, SIZE, "front", surfaces(middle))


def _place(frames: Sequence[Gaussians], up: Vector | None, solidity: float) -> tuple[FoundViews, Vector]:
    middle = frames[len(frames) // 2]
    search = Search(middle)
    search.scatter(SCATTERED, KEPT)
    search.refine(ROUNDS)
    ranked = _ranked(search.poses, frames)
    good = _good(ranked)
    doubt = "it may be an object in a haze" if solidity >= PERHAPS else _doubt(good)
    chosen = spread(ranked[: 2 * GUESSES], GUESSES) if doubt else _middle_first(spread(good, COUNT))
    subject = Subject.of(frames, None if doubt else _median(good))
    upright = guess_up(subject) if up is None else up / np.linalg.norm(up)
    cameras = [pose.camera(f"found{i:02d}", SIZE, upright) for i, pose in enumerate(chosen)]
    scores = [pose.look.score for pose in chosen]
    if not doubt:
        return FoundViews(cameras, scores, True, f"a filmed place: {_where(good, len(cameras))}"), upright
    front, around = _front(subject, middle, upright), dome_views(middle, GUESSES, SIZE, upright)
    story = f"unclear where from ({doubt}): {_where(chosen, len(cameras))}, and {1 + len(around)} all around"
    cameras, scores = [front, *cameras, *around], [0.0, *scores, *[0.0] * len(around)]
    return FoundViews(cameras, scores, False, story), upright


def _median(poses: Sequence[Pose]) -> tuple[Vector, Vector]:
    """(3,) the middle of the positions of poses, and (3,) that of their directions, of length 1."""
    positions, directions = (np.median([getattr(p, name) for p in poses], axis=0) for name in ("position", "direction"))
    return positions, unit(directions)


def _middle_first(poses: Sequence[Pose]) -> list[Pose]:
    """The poses, first the one that the others are nearest to."""
    middle = int(gaps(poses).sum(axis=1).argmin())
    return [poses[middle], *poses[:middle], *poses[middle + 1 :]]


def _ranked(poses: Sequence[Pose], frames: Sequence[Gaussians]) -> list[Pose]:
    """The best poses as all frames together judge them, as far apart as leaves enough good ones."""
    for apart in APART:
        ranked = judge(best_apart(poses, KEPT, apart), frames)
        if len(_good(ranked)) >= GUESSES:
            break
    return ranked


def _good(ranked: Sequence[Pose]) -> list[Pose]:
    return [pose for pose in ranked if pose.look.score >= GOOD * ranked[0].look.score]


def _doubt(good: Sequence[Pose]) -> str:
    """Why these may not be the places that a scene was filmed from; empty for no doubt."""
    best, covered = good[0].look.score, float(np.median([pose.look.covered for pose in good]))
    if best < SURE:
        return f"the best score is {best:.3f}, filmed places have {SURE} or more"
    if covered < SURE_COVERED:
        return f"{1 - covered:.0%} of pictures are empty, of filmed places at most {1 - SURE_COVERED:.0%}"
    return ""


def _where(poses: Sequence[Pose], views: int) -> str:
    """Where some views are."""
    regions = connected_components(gaps(poses) <= REGION)[0]
    x, y, z = np.median([pose.position for pose in poses], axis=0)
    away = float(np.median([pose.look.distance for pose in poses]))
    place = f"{regions} region{'s' if regions > 1 else ''} about ({x:.3g}, {y:.3g}, {z:.3g})"
    return f"{views} views from {place}, {away:.3g} from what they see"
