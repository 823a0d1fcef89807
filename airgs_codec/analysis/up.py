"""Which way is up in a scene that comes without cameras, and where its front is: cues vote, none of them decides alone.

Candidates are the six directions of the axes and the normals of a floor (K of them). A cue is a function that gives a
candidate a number; `WEIGHTS` says what it counts, and the most votes win. Weights of shapes were fitted together
(conditional logit) to animated models of people, animals and things; a floor is chosen to outvote shapes, and habits
of files to decide between what shapes leave open. `tools.lab upright` measures what they are worth.

T frames, n points drawn of each by how much their rows can cover, in units of the size of the scene.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, KDTree, QhullError

from airgs_codec.analysis.floor import CONE, find_floor, normals_of
from airgs_codec.scene.gaussians import SH_C0, Gaussians

Vectors = NDArray[np.float64]

POINTS = 2000  # drawn of a frame
MIRRORED = 300  # points that symmetry is measured with
NEIGHBOURS = 9  # points, of which the spread of colours is detail
HEADINGS = np.radians(np.arange(0, 180, 10))  # of mirrors that contain a direction
ENDS = (0.005, 0.995)  # quantiles of heights: below and above is what floats
FOOT, LEG = 0.06, 0.15  # of the height: what touches the ground, and what stands on it
SLABS = np.array([-np.inf, 1, 2, 3, 4, 5, 6, 7, np.inf]) / 8  # of the height
STILL = 0.05  # of the mean motion: what moves less rests
SHUFFLED = 0.25  # of the size: where rows move farther between two frames, they are other rows
LEVEL = np.cos(np.radians(20))  # candidates nearer to a floor's normal than this are the same direction
LEAST = 1e-4  # of the size: keeps ln(0) and 0 / 0 out
AXES = np.concatenate([np.eye(3), -np.eye(3)])

HABITS = np.array([0, 2, 1, 0, 2, 0])  # of AXES: structure from motion mostly leaves -y up, drawing programs y or z
WEIGHTS = {"habit": 1.0, "floor": 20.0, "halves": 3.5, "foot": 4.7, "stance": 3.2, "rest": 0.7, "mass": 1.0}
FILMED = {"habit": 1.0, "floor": 5.0, "level": 5.0, "seen": 10.0, "light": 5.0}  # of places, which have no outside
MASS = np.array([-8.1, -10.6, 0.0, 1.5, -4.6, 1.0, 8.5, 14.5])  # votes for all of the surface in a slab, lowest first


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """Some points on the surfaces of a frame."""

    at: Vectors  # (n, 3)
    normals: Vectors  # (n, 3) of length 1, of either sign
    light: Vectors  # (n,) mean of r, g, b
    detail: Vectors  # (n,) standard deviation of the colours about each

    def heights(self, up: Vectors) -> Vectors:
        """(n,) 0 at the lowest, 1 at the highest, by `ENDS`."""
        heights = self.at @ up
        low, high = np.quantile(heights, ENDS)
        return np.asarray((heights - low) / max(float(high - low), LEAST))


@dataclass(frozen=True, slots=True, eq=False)
class Subject:
    """What cues look at."""

    frames: Sequence[Points]
    motion: Vectors  # (n,) how far the points of the first frame get, or what is nearest to them where rows are others
    floor: Vectors | None  # (3,) the direction away from a floor
    viewer: tuple[Vectors, Vectors] | None = None  # (3,) where a place was filmed from, and the direction

    @staticmethod
    def of(frames: Sequence[Gaussians], viewer: tuple[Vectors, Vectors] | None = None) -> Subject:
        """Points of repaired frames; a viewer's position is in world units."""
        middle = frames[len(frames) // 2]
        low, high = np.quantile(middle.means.astype(np.float64), [0.01, 0.99], axis=0)
        centre, size = (low + high) / 2, float(np.linalg.norm(high - low) + np.finfo(np.float32).tiny)
        same = all(_moved(frame, middle) < SHUFFLED * size for frame in frames)
        points = [_points(frame, _drawn(middle if same else frame), centre, size) for frame in frames]
        if same:
            motion = np.linalg.norm(np.ptp([one.at for one in points], axis=0), axis=1)
        else:
            motion = np.max([KDTree((f.means - centre) / size).query(points[0].at)[0] for f in frames[1:]], axis=0)
        where = viewer and ((viewer[0] - centre) / size, viewer[1])
        return Subject(points, motion, find_floor(middle), where)

    def mean(self, cue: Callable[[Points], float]) -> float:
        """Of all frames."""
        return float(np.mean([cue(points) for points in self.frames]))


def habit(_: Subject, up: Vectors) -> float:
    """What files mostly have where their format leaves it open."""
    return float(HABITS @ (up @ AXES.T > LEVEL))


def floor(subject: Subject, up: Vectors) -> float:
    """1 away from the plane that all else is on one side of."""
    return 0.0 if subject.floor is None else float(subject.floor @ up > LEVEL)


def halves(subject: Subject, up: Vectors) -> float:
    """How alike halves on both sides of the best upright mirror are: -ln of the distance between them."""
    return subject.mean(lambda points: -float(np.log(max(_mirrors(points, up)[0].min(), LEAST))))


def foot(subject: Subject, up: Vectors) -> float:
    """The area that what is lowest stands on, as a share of that of all."""
    return subject.mean(lambda points: _area(points, up, points.heights(up) < FOOT))


def stance(subject: Subject, up: Vectors) -> float:
    """By how much it is wider at its lower end than at its upper one, in the same shares."""

    def wider(points: Points) -> float:
        heights = points.heights(up)
        return _area(points, up, heights < LEG) - _area(points, up, heights > 1 - LEG)

    return subject.mean(wider)


def rest(subject: Subject, up: Vectors) -> float:
    """Whether the lower end rests and the upper one moves: ln of how much more it does."""
    heights, motion = subject.frames[0].heights(up), subject.motion
    ends = heights <= LEG, heights >= 1 - LEG
    if motion.mean() < LEAST or not all(end.any() for end in ends):  # nothing moves, or there is but one height
        return 0.0
    low, high = (float(np.median(motion[end])) for end in ends)
    least = STILL * float(motion.mean())
    return float(np.log((high + least) / (low + least)))


def mass(subject: Subject, up: Vectors) -> float:
    """Votes of how surfaces are spread over the height: legs are thin, and bodies and heads are above them."""
    return subject.mean(lambda points: float(np.histogram(points.heights(up), SLABS)[0] @ MASS) / len(points.at))


def level(subject: Subject, up: Vectors) -> float:
    """Who films a place holds the camera level: 0, or -1 where it looks along the candidate."""
    return -abs(float(subject.viewer[1] @ up)) if subject.viewer else 0.0


def seen(subject: Subject, up: Vectors) -> float:
    """Floors and tables are filmed from above: the share of surfaces that face up less that of those that face down."""
    if subject.viewer is None:
        return 0.0
    eye = subject.viewer[0]

    def facing(points: Points) -> float:
        towards = np.sign(((eye - points.at) * points.normals).sum(axis=1))
        rise = towards * (points.normals @ up)
        return float((rise > CONE).mean() - (rise < -CONE).mean())

    return subject.mean(facing)


def light(subject: Subject, up: Vectors) -> float:
    """Skies, windows and ceilings are lighter than grounds: the correlation of brightness and height."""

    def lighter(points: Points) -> float:
        heights, values = (column - column.mean() for column in (points.heights(up).clip(0, 1), points.light))
        return float((heights * values).mean() / max(float(heights.std() * values.std()), LEAST))

    return subject.mean(lighter)


CUES = {cue.__name__: cue for cue in (habit, floor, halves, foot, stance, rest, mass, level, seen, light)}


def guess_up(subject: Subject) -> Vectors:
    """(3,) the direction that is probably up, of length 1."""
    candidates, plane = AXES, subject.floor
    if plane is not None:
        candidates = np.concatenate([AXES[np.abs(AXES @ plane) < LEVEL], [plane, -plane]])
    weights = FILMED if subject.viewer else WEIGHTS
    votes = [sum(weight * CUES[name](subject, up) for name, weight in weights.items()) for up in candidates]
    return np.asarray(candidates[int(np.argmax(votes))])


def surfaces(gaussians: Gaussians) -> Vectors:
    """(N,) how much each row can cover, 0 to 1; the largest hundredth of them count alike, for a haze is no surface."""
    areas = gaussians.areas()
    return np.asarray(np.minimum(areas / max(float(np.quantile(areas, 0.99)), np.finfo(np.float64).tiny), 1))


def find_front(subject: Subject, up: Vectors) -> Vectors:
    """(3,) from where a thing that is upright along `up` (3,) is looked at: along its mirror, where the detail is."""
    points = subject.frames[len(subject.frames) // 2]
    unlike, normals = _mirrors(points, up)
    ahead = np.cross(up, normals[unlike.argmin()])
    along = points.at @ ahead
    more = np.average(along, weights=points.detail + LEAST) - along.mean()
    return np.asarray(ahead if more >= 0 else -ahead)


def _moved(frame: Gaussians, other: Gaussians) -> float:
    """How far rows get from one frame to another, world units; inf where these have not as many."""
    if len(frame) != len(other):
        return np.inf
    return float(np.median(np.linalg.norm(frame.means.astype(np.float64) - other.means, axis=1)))


def _drawn(gaussians: Gaussians) -> NDArray[np.int64]:
    shares = surfaces(gaussians) + np.finfo(np.float64).tiny
    count = min(POINTS, len(gaussians))
    return np.sort(np.random.default_rng(0).choice(len(gaussians), count, p=shares / shares.sum()))


def _points(gaussians: Gaussians, rows: NDArray[np.int64], centre: Vectors, size: float) -> Points:
    g = gaussians.take(rows)
    at, colours = (g.means - centre) / size, 0.5 + SH_C0 * g.sh_dc.astype(np.float64)
    near = KDTree(at).query(at, k=min(NEIGHBOURS, len(at)))[1].reshape(len(at), -1)
    return Points(at, normals_of(g), colours.clip(0, 1).mean(axis=1), colours[near].std(axis=1).mean(axis=1))


def _mirrors(points: Points, up: Vectors) -> tuple[Vectors, Vectors]:
    """How unlike halves on both sides of mirrors that contain `up` are, as a distance; and (H, 3) their normals."""
    a, b = _across(up)
    normals = np.cos(HEADINGS)[:, None] * a + np.sin(HEADINGS)[:, None] * b
    away = points.at @ normals.T
    middles = np.quantile(away, [0.01, 0.99], axis=0).mean(axis=0)
    some = slice(None, None, max(1, len(points.at) // MIRRORED))
    images = points.at[some, None] - 2 * (away[some] - middles)[..., None] * normals
    return KDTree(points.at).query(images)[0].mean(axis=0), normals


def _across(up: Vectors) -> Vectors:
    """(2, 3) two directions at right angles to `up` and to each other."""
    return np.asarray(np.linalg.svd(up[None])[2][1:])


def _area(points: Points, up: Vectors, chosen: NDArray[np.bool_]) -> float:
    """The area of the hull of the chosen points as seen from above, as a share of that of all."""
    flat = points.at @ _across(up).T
    try:
        return float(ConvexHull(flat[chosen]).volume / ConvexHull(flat).volume)
    except (QhullError, ValueError):  # fewer than three, or in a line
        return 0.0
