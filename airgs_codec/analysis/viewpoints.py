"""From where a scene that comes without cameras is meant to be seen.

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

from airgs_codec.analysis.up import SAME, Subject, find_front, flatness, guess_up, surfaces
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
from airgs_codec.scene.formats.form import Axes
from airgs_codec.scene.frames import repair
from airgs_codec.scene.gaussians import LARGEST, SH_C0, Gaussians, from_rotation_vector, remoteness_in, to_matrices

Floats = NDArray[np.float32]
Vector = NDArray[np.float64]

VIEW_PIXELS = 256  # pixels of found views
GUESS = ("up is guessed", "cannot tell up")  # the first words of the note about it
SAVED = "cameras given with --views save bytes or quality (in four scenes up to 40 % or 4 dB)"

STEPS = 0.25 * 0.75 ** np.arange(5)  # of the distance to what is seen, and radians: rounds about the best poses
TURN_ANGLE = np.radians(35)  # is as far as half the distance to what is seen
SURE = 0.05  # score of the best; real captures have 0.1 to 0.2, broken ones mostly up to 0.03
ANGLES = np.radians([2.5, 1.0])  # a Gaussian of this standard deviation, seen from the camera, counts 1 / e
FARTHEST = 1e9  # sizes of the scene; what is larger or further squares to more than float32 holds
TINY = 1e-12  # avoids 0 / 0 where nothing is drawn


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """Some rows of a frame, chosen by how much they can cover, and grown in place of those that were not chosen."""

    inputs: RasterInputs[Floats]
    covariances: Floats  # (n, 6) xx, yy, zz, 2 xy, 2 xz, 2 yz of the rows before they were grown
    flatness: Floats  # (n,) 0 for needles and balls, 1 for discs

    @staticmethod
    def of(gaussians: Gaussians, rows: int, seed: int = 0) -> Sample:
        """Draw about `rows` of a frame's rows, which are finite and have quaternions of length 1.

        Raises SceneError when no row can be seen.
        """
        drawn = (np.abs(gaussians.means) < FARTHEST).all(axis=1) & (gaussians.log_scales < np.log(FARTHEST)).all(axis=1)
        visible = np.flatnonzero(drawn & (gaussians.opacities() > 0.01))
        if not visible.size:
            raise SceneError(f"expected a Gaussian with opacity above 0.01, got none in {len(gaussians)}")
        weights = np.sqrt(gaussians.areas()[visible])
        chances = np.ones(len(weights))
        if rows < len(weights):
            chances = np.minimum(1, weights * rows / weights.sum())
            for _ in range(20):  # what is cut at 1 is shared by the others
                chances = np.minimum(1, chances * rows / chances.sum())
        picked = np.random.default_rng(seed).random(len(visible)) < chances
        g = gaussians.take(visible[picked]).with_degree(0)
        growth = -0.5 * np.log(chances[picked])  # a row that stands for k rows has k times their area
        grown = replace(g, log_scales=(g.log_scales + growth[:, None]).astype(np.float32))
        axes = to_matrices(g.quaternions) * np.exp(np.minimum(g.log_scales.astype(np.float64), LARGEST))[:, None, :]
        c = axes @ axes.transpose(0, 2, 1)
        columns = (c[:, 0, 0], c[:, 1, 1], c[:, 2, 2], 2 * c[:, 0, 1], 2 * c[:, 0, 2], 2 * c[:, 1, 2])
        return Sample(cpu.activate(grown), np.stack(columns, axis=1).astype(np.float32), flatness(g))

    def look(self, camera: Camera) -> tuple[float, float]:
        """Return the score, 0..1, of what a camera sees, and how far that is: the geometric mean over rows ahead.

        The score is the share of the picture that small flat Gaussians explain; holes and splintered depth lower it.
        """
        sizes, distances = self._angles(camera)
        worth = self.flatness * np.exp(-sizes[:, None] / ANGLES).mean(axis=1)
        surface, depth, alpha = self._draw(camera, worth, np.log(distances / distances.min()))
        depth, seen = np.divide(depth, np.maximum(alpha, TINY), dtype=np.float32), alpha > 0.5
        pairs = ((seen[1:] & seen[:-1]), (seen[:, 1:] & seen[:, :-1]))
        steps = (np.abs(np.diff(depth, axis=axis))[both] for axis, both in enumerate(pairs))
        rough = sum(float(step.mean()) for step in steps if step.size)
        # A picture with a hole of a quarter counts a third; a change of 0.2 in the logarithm of depth 1 / e.
        score = float(surface.mean()) * float(alpha.mean()) ** 4 * float(np.exp(-rough / 0.2))
        ahead = (self.inputs.means - camera.position.astype(np.float32)) @ camera.world_to_camera[2, :3]
        near = ahead > distances * 0.7
        return score, float(np.exp(np.log(distances[near] if near.any() else distances).mean()))

    def solidity(self, camera: Camera) -> float:
        """Return the share of covered pixels that are opaque and explained by small Gaussians; 0 without any."""
        small = np.exp(-self._angles(camera)[0] / np.radians(6))
        part, _, alpha = self._draw(camera, small, small)
        return float(part[alpha > 0.9].sum()) / max(float(alpha.sum()), TINY)

    def _draw(self, camera: Camera, a: Floats, b: Floats) -> tuple[Floats, Floats, Floats]:
        """Return (H, W) sums of two values of rows, at least 0, weighted as they are blended; and opacities."""
        sh = ((np.stack([a, b, b], axis=1)[:, None] - 0.5) / SH_C0).astype(np.float32)
        picture = cpu.blend(self.inputs._replace(sh=sh), camera, BLACK).picture
        return picture.rgb[..., 0], picture.rgb[..., 1], 1 - picture.transmittance

    def _angles(self, camera: Camera) -> tuple[Floats, Floats]:
        """Return (n,) standard deviations across the line of sight in radians, and (n,) distances."""
        to = self.inputs.means - camera.position.astype(np.float32)
        x, y, z = to.T
        squares = np.einsum("ni,ni->n", to, to) + np.float32(TINY)
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
        """Look from `position` along `direction`, of any length, by default z: the mean over samples."""
        length = float(np.linalg.norm(direction))
        direction = direction / length if length > 0 else np.array([0.0, 0.0, 1.0])
        camera = _camera(position, direction, UP, 32, "tried")
        score, distance = np.mean([sample.look(camera) for sample in samples], axis=0)
        return Pose(position, direction, float(score), float(distance))


def _camera(position: Vector, direction: Vector, up: Vector, size: int, name: str) -> Camera:
    camera = look_at(position, position + direction, up, size=size, fov_y=np.radians(60), name=name)
    return replace(camera, near=NEAR_SHARE)


def _search(gaussians: Gaussians) -> list[Pose]:
    """Return poses tried at random, then ever closer about the best of each neighbourhood; always the same."""
    samples, rng = [Sample.of(gaussians, 4000)], np.random.default_rng(0)
    means = samples[0].inputs.means.astype(np.float64)
    low, high = np.quantile(means, [0.05, 0.95], axis=0)
    poses = []
    for i in range(300):  # half of them anywhere in the box of the scene, half about something to see
        target = means[rng.integers(len(means))]
        place = rng.uniform(1.5 * low - 0.5 * high, 1.5 * high - 0.5 * low)
        if i % 2:
            away = rng.normal(size=3)
            place = target + float((high - low).max()) * 10 ** rng.uniform(-1, 0.2) * away / np.linalg.norm(away)
        poses.append(Pose.tried(samples, place, target - place))
    for step in STEPS:
        for parent in _best_distinct(poses, 12, 1.0):
            for _ in range(3):
                shift = rng.normal(0, step * parent.distance, 3)
                poses.append(Pose.tried(samples, parent.position + shift, parent.direction + rng.normal(0, step, 3)))
            turn = to_matrices(from_rotation_vector(rng.normal(0, np.radians(30), 3)))  # rings of cameras are found so
            seen = parent.position + parent.distance * parent.direction
            poses.append(Pose.tried(samples, seen + turn @ (parent.position - seen), turn @ parent.direction))
    return poses


def _best_distinct(poses: Sequence[Pose], count: int, gap: float) -> list[Pose]:
    """Return the best poses, at most `count`, none closer than `gap`: 1 is TURN_ANGLE, or half the scene's distance."""
    chosen: list[Pose] = []
    left = sorted(poses, key=lambda pose: -pose.score)
    while left and len(chosen) < count:
        best = left[0]
        chosen.append(best)
        away = np.linalg.norm([pose.position - best.position for pose in left], axis=1)
        moves = away / (0.5 * np.minimum([pose.distance for pose in left], best.distance))
        turns = np.arccos(np.clip([pose.direction @ best.direction for pose in left], -1, 1)) / TURN_ANGLE
        left = [pose for pose, far in zip(left, np.hypot(moves, turns) >= gap, strict=True) if far]
    return chosen


@dataclass(frozen=True, slots=True, eq=False)
class FoundViews:
    """Cameras that stand for all places from which a scene looks good."""

    cameras: list[Camera]  # first the one that viewers begin at
    confident: bool  # whether viewers stay near these cameras; else they may be anywhere
    summary: str  # what was found, and how sure that is
    up: Vector  # (3,) of length 1
    guess: str = ""  # how up was guessed, where nobody gave it


def find_viewpoints(
    frames: Sequence[Gaussians], up: Vector | None = None, axes: Axes | None = None, form: str = "splat"
) -> FoundViews:
    """Find where some frames of a scene are meant to be seen from. The middle one decides, all of them judge.

    The same frames give the same square cameras. `up` (3,) points up where it is known; else it is guessed
    (`analysis.up`): files of the `form` have that of the `axes` by specification, else mostly -y. Frames need neither
    be repaired nor share rows. What is far from all else is ignored. Raises SceneError when a frame has no finite row.
    """
    frames = [repair([frame], "views").frames[0] for frame in frames]
    frames = [frame.take(remoteness_in(frame)(frame) <= 1) for frame in frames]
    middle = frames[len(frames) // 2]
    origin, size = extent_of(middle.means.astype(np.float64), middle.opacities().astype(np.float64))
    found = _find([frame.placed(-origin, 1 / size) for frame in frames], up, axes, form)
    return replace(found, cameras=[placed(camera, origin / size, size) for camera in found.cameras])


def _find(frames: Sequence[Gaussians], up: Vector | None, axes: Axes | None, form: str) -> FoundViews:
    middle = frames[len(frames) // 2]
    subject = Subject.of(middle)
    with one_thread():
        try:
            poses, unclear = _find_places(frames, middle)
        except SceneError:
            poses, unclear = [], "nothing can be seen"
    known = None if up is None else (up / np.linalg.norm(up), True, "")
    upright, sure, guess = known or _guess(subject, bool(poses), axes, form)
    if poses:
        cameras = [_camera(p.position, p.direction, upright, VIEW_PIXELS, f"found{i:02d}") for i, p in enumerate(poses)]
        what = f"a filmed place: {len(cameras)} views from all over it; {SAVED}"
        return FoundViews(cameras, True, what, upright, guess)
    stands = subject.floor is not None and float(subject.floor @ upright) > np.cos(np.radians(20))
    low, high = (0, 75) if stands else (-30, 60)  # people walk around an object, and look up or down a little
    rise = np.radians(12)
    front, clear = find_front(subject, upright)
    ahead = np.cos(rise) * front + np.sin(rise) * upright
    first = side_view(middle, ahead, upright, VIEW_PIXELS, "front", surfaces(middle))
    around = dome_views(middle, 24, VIEW_PIXELS, upright, (np.radians(low), np.radians(high)))
    centre = looked_at(around)
    for i in range(1, len(around), 2):  # every second one from 0.6 of the distance
        matrix = around[i].world_to_camera.copy()
        matrix[:3, 3] = 0.6 * matrix[:3, 3] - (1 - 0.6) * matrix[:3, :3] @ centre
        around[i] = replace(around[i], world_to_camera=matrix, near=0.6 * around[i].near)
    side = "in front" if sure and clear else "a side that may be its front"
    where = f"a view from {side} and 24 around it, near and far, {low}° to {high}° above the horizon"
    where += ", over its floor" if stands else ""
    what = f"unclear where from ({unclear})" if unclear else "an object in empty space"
    return FoundViews([first, *around], not unclear, f"{what}: {where}; {SAVED}", upright, guess)


def _guess(subject: Subject, filmed: bool, axes: Axes | None, form: str) -> tuple[Vector, bool, str]:
    """Return up, whether that is sure, and a sentence on it. What is not sure is as a specification says."""
    usual = np.array(axes.up if axes else UP, np.float64)
    up, sure = guess_up(subject, usual, filmed)
    up = usual if axes and not sure else up
    shown = ", ".join(f"{value:g}" for value in up.round(2) + 0.0)
    often = f"{form} files {'should' if axes else 'mostly'} have"
    why = f"as {often} it" if up @ usual > SAME else f"though {often} another"
    if sure:
        return up, sure, f"{GUESS[0]} to be ({shown}), {why}; --up says otherwise"
    over = f"--up={'-' if up.sum() > 0 else ''}{'xyz'[int(np.abs(up).argmax())]}"
    hint = f"{over}, or turn it over in the player and keep that: airgs-manifest set-view PACKAGE {over}"
    return up, sure, f"{GUESS[1]}: showing ({shown}), {why}; if that is upside down, {hint}"


def _find_places(frames: Sequence[Gaussians], middle: Gaussians) -> tuple[list[Pose], str]:
    """Return where a place was probably filmed from, best first, or why that is unclear; neither for an object.

    The first ones only say where viewers begin; from the others, all over the place, they may look as well. Raises
    SceneError when no row can be seen.
    """
    sample = Sample.of(middle, 8000)
    sides = [sample.solidity(camera) for camera in dome_views(middle, 12, 48, UP)]
    if (solidity := float(np.quantile(sides, 0.25))) >= 0.52:  # places have less
        return [], "" if solidity >= 0.6 else "it may be an object in a haze"
    samples = [Sample.of(frame, 4000, seed=1) for frame in frames]
    poses = _search(middle)
    judged = [Pose.tried(samples, p.position, p.direction) for p in _best_distinct(poses, 40, 0.2)]
    best = max(pose.score for pose in judged)
    if best < SURE:
        return [], f"the best score is {best:.3f}, filmed places have {SURE} or more"
    good = _best_distinct([pose for pose in judged if pose.score >= 0.7 * best], 12, 0.2)
    return good + _best_distinct([pose for pose in poses if pose.score >= 0.2 * best], 36, 1.0), ""
