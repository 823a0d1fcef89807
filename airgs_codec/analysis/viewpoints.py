"""Where a scene that comes without cameras is meant to be seen from.

An object whose surroundings are empty is seen from in front and from all around. A filmed place is seen from where
pictures of it look like pictures, which a search finds: at random, then about the best of each neighbourhood. Where no
place looks good, the answer says so, and its cameras are those of an object.

From where a scene was filmed, surfaces are made of many small flat Gaussians, and there is something behind every
pixel; from elsewhere one sees needles, backs of walls, and what floats before a lens. n rows of a sample, H x W pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec.analysis.up import Subject, find_front, flatness, guess_up, surfaces
from airgs_codec.errors import SceneError
from airgs_codec.render import cpu
from airgs_codec.render.cpu import RasterInputs, one_thread
from airgs_codec.scene.camera import (
    BLACK,
    NEAR_SHARE,
    UP,
    Camera,
    dome_views,
    extent_of,
    look_at,
    looked_at,
    placed,
    side_view,
)  # fmt: skip
from airgs_codec.scene.frames import repair
from airgs_codec.scene.gaussians import LARGEST, SH_C0, Gaussians, from_rotation_vector, remoteness_in, to_matrices

Floats = NDArray[np.float32]
Vector = NDArray[np.float64]

SIZE = 256  # pixels of the cameras
GUESS = "up is guessed to be "  # how the line about it begins
SAVED = "cameras given with --views save bytes or quality (in four scenes up to 40 % or 4 dB)"

# An object: people walk around it, and look up or down a little.
SIDES, SIDE_SIZE, SIDE_ROWS = 12, 48, 8000  # views, pixels and rows that tell an object from a place
OBJECT, PERHAPS = 0.6, 0.52  # solidity of three in four sides of an object, and of what may be one; places have less
AROUND, ON_FLOOR = np.radians([-30, 60]), np.radians([0, 75])  # lowest and highest view above the horizon
VIEWS, NEARER = 12, 0.6  # views that show all of it, and as many again from this share of their distance
UPRIGHT = np.cos(np.radians(20))  # between the floor's own up and the one that is given
RISE = np.radians(12)  # of the first view above the horizon

# A place, and its search.
FIELD_OF_VIEW = np.radians(60)  # of both axes
TRIED_SIZE, ROWS = 32, 4000  # pixels of a pose that is tried, and rows of the scene that it shows
SCATTERED = 300  # poses tried at random
STEPS = 0.25 * 0.75 ** np.arange(5)  # of the distance to what is seen, and radians: rounds about the best of them
PARENTS, CHILDREN = 12, 3  # neighbourhoods that a round looks about, and poses tried about the best of each
WALK = np.radians(30)  # standard deviation of a turn about what is seen, by each axis: rings of cameras are found so
JUDGED = 40  # poses that other samples of all frames judge
TURN = np.radians(35)  # is as far as half the distance to what is seen
APART = 0.2  # from one camera to the next, in such units
GOOD, BEST = 0.7, 12  # of the best score, and of them at most so many: viewers begin there
FAIR, OTHERS = 0.2, 36  # of that score, and at most so many: from there people look as well, for all that is known
SURE = 0.05  # score of the best; real captures have 0.1 to 0.2, broken ones mostly up to 0.03

# How well a picture looks.
ANGLES = np.radians([2.5, 1.0])  # a Gaussian of this standard deviation, seen from the camera, counts 1 / e
PART = np.radians(6)  # the same for a part of an object that fills a picture
VISIBLE = 0.01  # opacity; rows below it are passed over
EMPTY = 4  # power of the covered share: a picture with a hole of a quarter counts a third
SOLID, HALF = 0.9, 0.5  # opacity of a pixel of an object, and of one that has a depth
ROUGH = 0.2  # change of the logarithm of depth from pixel to pixel that counts 1 / e
AHEAD = 0.7  # cosine
WIDEST = 1e9  # sizes of the scene; what is larger or further squares to more than float32 holds
LEAST = 1e-12  # avoids 0 / 0 where nothing is drawn


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """Some rows of a frame, chosen by how much they can cover, and grown for those that were not chosen."""

    inputs: RasterInputs[Floats]
    covariances: Floats  # (n, 6) xx, yy, zz, 2 xy, 2 xz, 2 yz of the rows as they were
    flatness: Floats  # (n,) 0 for needles and balls, 1 for discs

    @staticmethod
    def of(gaussians: Gaussians, rows: int, seed: int = 0) -> Sample:
        """About `rows` of the frame's rows, which are finite and have quaternions of length 1.

        Raises SceneError when no row can be seen.
        """
        drawn = (np.abs(gaussians.means) < WIDEST).all(axis=1) & (gaussians.log_scales < np.log(WIDEST)).all(axis=1)
        visible = np.flatnonzero(drawn & (gaussians.opacities() > VISIBLE))
        if not visible.size:
            raise SceneError(f"expected a Gaussian with opacity above {VISIBLE}, got none in {len(gaussians)}")
        weights = np.sqrt(gaussians.areas()[visible])
        chances = np.ones(len(weights))
        if rows < len(weights):
            chances = np.minimum(1, weights * rows / weights.sum())
            for _ in range(20):  # what is cut at 1 is dealt out to the others
                chances = np.minimum(1, chances * rows / chances.sum())
        picked = np.random.default_rng(seed).random(len(visible)) < chances
        g = gaussians.take(visible[picked]).with_degree(0)
        growth = -0.5 * np.log(chances[picked])  # a row that stands for k rows has k times their area
        grown = replace(g, log_scales=(g.log_scales + growth[:, None]).astype(np.float32))
        scales = np.exp(np.minimum(g.log_scales.astype(np.float64), LARGEST))
        axes = to_matrices(g.quaternions) * scales[:, None, :]
        c = axes @ axes.transpose(0, 2, 1)
        columns = (c[:, 0, 0], c[:, 1, 1], c[:, 2, 2], 2 * c[:, 0, 1], 2 * c[:, 0, 2], 2 * c[:, 1, 2])
        return Sample(cpu.activate(grown), np.stack(columns, axis=1).astype(np.float32), flatness(g))

    def look(self, camera: Camera) -> tuple[float, float]:
        """The score of what `camera` sees, 0..1, and how far away that is: the geometric mean over rows ahead.

        The score is the share of the picture that small flat Gaussians explain; holes and splintered depth lower it.
        """
        sizes, distances = self._angles(camera)
        worth = self.flatness * np.exp(-sizes[:, None] / ANGLES).mean(axis=1)
        surface, depth, alpha = self._draw(camera, worth, np.log(distances / distances.min()))
        depth, seen = np.divide(depth, np.maximum(alpha, LEAST), dtype=np.float32), alpha > HALF
        steps = (
            (np.abs(np.diff(depth, axis=0)), seen[1:] & seen[:-1]),
            (np.abs(np.diff(depth, axis=1)), seen[:, 1:] & seen[:, :-1]),
        )
        rough = sum(float(step[both].mean()) for step, both in steps if both.any())
        score = float(surface.mean()) * float(alpha.mean()) ** EMPTY * float(np.exp(-rough / ROUGH))
        ahead = (self.inputs.means - camera.position.astype(np.float32)) @ camera.world_to_camera[2, :3]
        near = ahead > distances * AHEAD
        return score, float(np.exp(np.log(distances[near] if near.any() else distances).mean()))

    def solidity(self, camera: Camera) -> float:
        """Share of pixels that are opaque and explained by small Gaussians, of what is covered; 0 where nothing is."""
        small = np.exp(-self._angles(camera)[0] / PART)
        part, _, alpha = self._draw(camera, small, small)
        return float(part[alpha > SOLID].sum()) / max(float(alpha.sum()), LEAST)

    def _draw(self, camera: Camera, a: Floats, b: Floats) -> tuple[Floats, Floats, Floats]:
        """(H, W) sums of two values of rows, at least 0, weighted as they are blended; and opacities."""
        sh = ((np.stack([a, b, b], axis=1)[:, None] - 0.5) / SH_C0).astype(np.float32)
        picture = cpu.blend(self.inputs._replace(sh=sh), camera, BLACK).picture
        return picture.rgb[..., 0], picture.rgb[..., 1], 1 - picture.transmittance

    def _angles(self, camera: Camera) -> tuple[Floats, Floats]:
        """(n,) standard deviations across the line of sight in radians, and (n,) distances in world units."""
        to = self.inputs.means - camera.position.astype(np.float32)
        x, y, z = to.T
        squares = np.einsum("ni,ni->n", to, to) + np.float32(LEAST)
        products = np.stack([x * x, y * y, z * z, x * y, x * z, y * z], axis=1)
        along = np.einsum("ni,ni->n", self.covariances, products) / squares
        across = np.maximum(self.covariances[:, :3].sum(axis=1) - along, 0)
        return np.sqrt(across / squares), np.sqrt(squares)


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """A place, a direction, and what is seen."""

    position: Vector  # (3,) world units
    direction: Vector  # (3,) of length 1
    score: float
    distance: float  # to what is seen

    @staticmethod
    def tried(samples: Sequence[Sample], position: Vector, direction: Vector) -> Pose:
        """Look from `position` along `direction`, of any length: the mean over samples. Where it has none, along z."""
        length = float(np.linalg.norm(direction))
        direction = direction / length if length > 0 else np.array([0.0, 0.0, 1.0])
        camera = _camera(position, direction, UP, TRIED_SIZE, "tried")
        score, distance = np.mean([sample.look(camera) for sample in samples], axis=0)
        return Pose(position, direction, float(score), float(distance))


def _camera(position: Vector, direction: Vector, up: Vector, size: int, name: str) -> Camera:
    camera = look_at(position, position + direction, up, size=size, fov_y=FIELD_OF_VIEW, name=name)
    return replace(camera, near=NEAR_SHARE)


def _search(gaussians: Gaussians) -> list[Pose]:
    """Poses, tried at random and then closer and closer about the best of each neighbourhood; always the same."""
    samples, rng = [Sample.of(gaussians, ROWS)], np.random.default_rng(0)
    means = samples[0].inputs.means.astype(np.float64)
    low, high = np.quantile(means, [0.05, 0.95], axis=0)
    poses = []
    for i in range(SCATTERED):  # half of them anywhere in the box of the scene, half about something to see
        target = means[rng.integers(len(means))]
        place = rng.uniform(1.5 * low - 0.5 * high, 1.5 * high - 0.5 * low)
        if i % 2:
            away = rng.normal(size=3)
            place = target + float((high - low).max()) * 10 ** rng.uniform(-1, 0.2) * away / np.linalg.norm(away)
        poses.append(Pose.tried(samples, place, target - place))
    for step in STEPS:
        for parent in _best_apart(poses, PARENTS, 1.0):
            for _ in range(CHILDREN):
                shift = rng.normal(0, step * parent.distance, 3)
                poses.append(Pose.tried(samples, parent.position + shift, parent.direction + rng.normal(0, step, 3)))
            turn = to_matrices(from_rotation_vector(rng.normal(0, WALK, 3)))
            seen = parent.position + parent.distance * parent.direction
            poses.append(Pose.tried(samples, seen + turn @ (parent.position - seen), turn @ parent.direction))
    return poses


def _best_apart(poses: Sequence[Pose], count: int, gap: float) -> list[Pose]:
    """The best poses, at most `count`, no two closer than `gap`: 1 is TURN, or half the distance to what is seen."""
    chosen: list[Pose] = []
    left = sorted(poses, key=lambda pose: -pose.score)
    while left and len(chosen) < count:
        best = left[0]
        chosen.append(best)
        away = np.linalg.norm([pose.position - best.position for pose in left], axis=1)
        moves = away / (0.5 * np.minimum([pose.distance for pose in left], best.distance))
        turns = np.arccos(np.clip([pose.direction @ best.direction for pose in left], -1, 1)) / TURN
        left = [pose for pose, far in zip(left, np.hypot(moves, turns) >= gap, strict=True) if far]
    return chosen


@dataclass(frozen=True, slots=True, eq=False)
class FoundViews:
    """Cameras that stand for all places from which a scene looks good."""

    cameras: list[Camera]  # first the one that viewers begin at
    confident: bool  # whether viewers stay near these cameras; else they may be anywhere
    story: str  # a line that says what was found, and how sure it is
    guess: str = ""  # one that says which way is up, where nobody gave it


def find_viewpoints(frames: Sequence[Gaussians], up: Vector | None = None) -> FoundViews:
    """Finds where some frames of a scene are meant to be seen from. The middle one decides, all of them judge.

    The same frames give the same square cameras. `up` (3,) points up where somebody gave it; else it is guessed
    (`analysis.up`). A frame need not be repaired; frames need not share rows. What is far from all else decides
    nothing. Raises SceneError when a frame has no finite row.
    """
    whole = [repair([frame], "views").frames[0] for frame in frames]
    frames = [frame.take(remoteness_in(frame)(frame) <= 1) for frame in whole]
    middle = frames[len(frames) // 2]
    origin, size = extent_of(middle.means.astype(np.float64), middle.opacities().astype(np.float64))
    found = _find([frame.placed(-origin, 1 / size) for frame in frames], up)
    return replace(found, cameras=[placed(camera, origin / size, size) for camera in found.cameras])


def _find(frames: Sequence[Gaussians], up: Vector | None) -> FoundViews:
    """`find_viewpoints` in frames of size 1 about the origin."""
    middle = frames[len(frames) // 2]
    subject = Subject.of(middle)
    with one_thread():
        try:
            poses, doubt = _find_places(frames, middle)
        except SceneError:
            poses, doubt = [], "nothing can be seen"
    upright = guess_up(subject, filmed=bool(poses)) if up is None else up / np.linalg.norm(up)
    x, y, z = upright.round(2) + 0.0
    guess = f"{GUESS}({x:g}, {y:g}, {z:g}); --up says otherwise" if up is None else ""
    if poses:
        cameras = [_camera(p.position, p.direction, upright, SIZE, f"found{i:02d}") for i, p in enumerate(poses)]
        return FoundViews(cameras, True, f"a filmed place: {len(cameras)} views from all over it; {SAVED}", guess)
    stands = subject.floor is not None and float(subject.floor @ upright) > UPRIGHT
    low, high = ON_FLOOR if stands else AROUND
    ahead = np.cos(RISE) * find_front(subject, upright) + np.sin(RISE) * upright
    front = side_view(middle, ahead, upright, SIZE, "front", surfaces(middle))
    around = dome_views(middle, 2 * VIEWS, SIZE, upright, (low, high))
    centre = looked_at(around)
    for i in range(1, len(around), 2):
        matrix = around[i].world_to_camera.copy()
        matrix[:3, 3] = NEARER * matrix[:3, 3] - (1 - NEARER) * matrix[:3, :3] @ centre
        around[i] = replace(around[i], world_to_camera=matrix, near=NEARER * around[i].near)
    where = f"a view from in front and {2 * VIEWS} around it, near and far, {np.degrees(low):.0f}° to"
    where += f" {np.degrees(high):.0f}° above the horizon{', over its floor' if stands else ''}"
    what = f"unclear where from ({doubt})" if doubt else "an object in empty space"
    return FoundViews([front, *around], not doubt, f"{what}: {where}; {SAVED}", guess)


def _find_places(frames: Sequence[Gaussians], middle: Gaussians) -> tuple[list[Pose], str]:
    """Where a place was probably filmed from, the best first, or why nobody knows; neither for an object.

    A guess only says where viewers begin: others, from all over the place, are from where they may look as well.
    Raises SceneError when no row can be seen.
    """
    sample = Sample.of(middle, SIDE_ROWS)
    sides = [sample.solidity(camera) for camera in dome_views(middle, SIDES, SIDE_SIZE, UP)]
    if (solidity := float(np.quantile(sides, 0.25))) >= PERHAPS:
        return [], "" if solidity >= OBJECT else "it may be an object in a haze"
    samples = [Sample.of(frame, ROWS, seed=1) for frame in frames]
    poses = _search(middle)
    judged = [Pose.tried(samples, p.position, p.direction) for p in _best_apart(poses, JUDGED, APART)]
    best = max(pose.score for pose in judged)
    if best < SURE:
        return [], f"the best score is {best:.3f}, filmed places have {SURE} or more"
    good = _best_apart([pose for pose in judged if pose.score >= GOOD * best], BEST, APART)
    return good + _best_apart([pose for pose in poses if pose.score >= FAIR * best], OTHERS, 1.0), ""
