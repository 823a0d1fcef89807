"""Which way is up in a scene that comes without cameras, and where its front is: votes, whose lead says how sure.

Candidates are the six directions of the axes and those away from and into a floor, the plane that all else is on one
side of. A floor votes before all; then feet, upright mirrors, and surfaces that are lighter than those around them
where they face the light; in a filmed place what is light above what is dark; and what files of the form have.

n points of a frame, drawn by how much their rows can cover, in units of the size of the scene; N rows.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, KDTree, QhullError

from airgs_codec.scene.camera import UP, spiral
from airgs_codec.scene.gaussians import SH_C0, Gaussians, to_matrices

Vectors = NDArray[np.float64]

SAME = np.cos(np.radians(30))  # directions nearer to each other count as one
SMALLEST = 1e-4  # of the size: avoids ln(0) and 0 / 0

SIX_AXES = np.concatenate([np.eye(3), -np.eye(3)])
HABITS = np.array([0, 2, 1, 0, 2, 0])  # votes for SIX_AXES: structure from motion mostly has -y up, programs y or z
FORM_VOTES, FLOOR_VOTES, FOOT_VOTES, MIRROR_VOTES, LIGHT_VOTES = 2.0, 10.0, 4.7, 3.5, 10.0
MOST_SHADE = 3.0  # votes of shading, at most
SURE_LEAD = 8.0  # votes ahead: of half of the measured scenes floors have 11 and more, what is wrong 5 and less
MIRRORED, DETAILED = 1.3, 0.2  # how much worse other mirrors and, in deviations, how far off the detail is of a front
SHADED = 5000  # rows that tell where a thing is lit from
BLOCKS = 12  # of a surface, each left out once to see how much the light on it varies

CONE = np.cos(np.radians(15))  # rows lie in a plane when their normals differ less from its own


@dataclass(frozen=True, slots=True, eq=False)
class Subject:
    """Points of a frame that stand for what is looked at."""

    at: Vectors  # (n, 3)
    light: Vectors  # (n,) mean of r, g, b
    detail: Vectors  # (n,) standard deviation of the colours about each
    floor: Vectors | None  # (3,) the direction away from a floor
    lit: Vectors  # (3,) how much lighter what faces along each axis is than what lies around it
    doubt: Vectors  # (3, 3) its covariance

    @staticmethod
    def of(frame: Gaussians) -> Subject:
        low, high = np.quantile(frame.means.astype(np.float64), [0.01, 0.99], axis=0)
        centre, size = (low + high) / 2, float(np.linalg.norm(high - low) + np.finfo(np.float32).tiny)
        shares = surfaces(frame) + np.finfo(np.float64).tiny
        count = min(2000, len(frame))
        g = frame.take(np.sort(np.random.default_rng(0).choice(len(frame), count, p=shares / shares.sum())))
        at, colours = (g.means - centre) / size, (0.5 + SH_C0 * g.sh_dc.astype(np.float64)).clip(0, 1)
        near = KDTree(at).query(at, k=min(9, count))[1].reshape(count, -1)
        waits = np.random.default_rng(0).exponential(size=len(frame)) / shares
        lit = _lit(frame.take(np.sort(np.argsort(waits)[:SHADED])))
        return Subject(at, colours.mean(axis=1), colours[near].std(axis=1).mean(axis=1), find_floor(frame), *lit)


def guess_up(subject: Subject, usual: Vectors = UP, filmed: bool = False) -> tuple[Vectors, bool]:
    """Return (3,) the direction that is probably up, of length 1, and whether that is sure.

    `usual` (3,) is up in most files of the form; `filmed`: the subject is a place without outside.
    """
    candidates, plane = SIX_AXES, subject.floor
    if plane is not None:
        candidates = np.concatenate([SIX_AXES[np.abs(SIX_AXES @ plane) < SAME], [plane, -plane]])
    votes = np.array([_votes(subject, up, filmed) for up in candidates]) + FORM_VOTES * (candidates @ usual > SAME)
    best = int(np.argmax(votes))
    lead = votes[best] - votes[candidates @ candidates[best] < SAME].max()
    return np.asarray(candidates[best]), bool(lead >= SURE_LEAD)


def _votes(subject: Subject, up: Vectors, filmed: bool) -> float:
    heights = subject.at @ up
    low, high = np.quantile(heights, [0.005, 0.995])  # what is below and above floats
    heights = (heights - low) / max(float(high - low), SMALLEST)  # 0 at the lowest, 1 at the highest
    votes = float(HABITS @ (up @ SIX_AXES.T > SAME))
    if filmed:
        above, lighter = (values - values.mean() for values in (heights.clip(0, 1), subject.light))
        return votes + LIGHT_VOTES * float((above * lighter).mean() / max(above.std() * lighter.std(), SMALLEST))
    if subject.floor is not None:
        votes += FLOOR_VOTES * float(subject.floor @ up > SAME)
    flat = subject.at @ _across(up).T
    with suppress(QhullError, ValueError):  # fewer than three points, or collinear ones
        votes += FOOT_VOTES * float(ConvexHull(flat[heights < 0.06]).volume / ConvexHull(flat).volume)
    spread = max(float(up @ subject.doubt @ up), np.finfo(np.float64).tiny) ** 0.5
    votes += float(np.clip(subject.lit @ up / spread, -MOST_SHADE, MOST_SHADE))
    return votes - MIRROR_VOTES * float(np.log(max(_mirrors(subject.at, up)[0].min(), SMALLEST)))


def _lit(g: Gaussians) -> tuple[Vectors, Vectors]:
    """Return where a thing is lit from, by surfaces that face otherwise than those around them, and its covariance."""
    at, light, count = g.means.astype(np.float64), SH_C0 * g.sh_dc.astype(np.float64).mean(axis=1), len(g)
    tree = KDTree(at)
    near = tree.query(at, k=min(16, count))[1].reshape(count, -1)
    offsets = at[near] - at[near].mean(axis=1, keepdims=True)
    spreads, axes = np.linalg.eigh(offsets.transpose(0, 2, 1) @ offsets)
    away = at - at[tree.query(at, k=max(1, count // 10))[1].reshape(count, -1)].mean(axis=1)
    normals = np.copysign(axes[:, :, 0], np.einsum("ni,ni->n", axes[:, :, 0], away)[:, None] * axes[:, :, 0])
    thin, wide = np.maximum(spreads[:, :2], np.finfo(np.float64).tiny).T
    turns, lighter = normals - normals[near].mean(axis=1), light - light[near].mean(axis=1)
    weighted = turns * (1 - np.sqrt(thin / wide))[:, None]
    blocks = KDTree(at[np.random.default_rng(0).integers(count, size=BLOCKS)]).query(at)[1]

    rows = [blocks != block for block in range(BLOCKS + 1)]  # of the last one all
    fits = [np.linalg.lstsq(weighted[some].T @ turns[some], weighted[some].T @ lighter[some])[0] for some in rows]
    return fits[-1], np.cov(np.transpose(fits[:-1])) * (BLOCKS - 1) ** 2 / BLOCKS


def surfaces(gaussians: Gaussians) -> Vectors:
    """Return (N,) how much each row can cover, 0 to 1; the largest hundredth count as one: a haze is no surface."""
    areas = gaussians.areas()
    return np.asarray(np.minimum(areas / max(float(np.quantile(areas, 0.99)), np.finfo(np.float64).tiny), 1))


def find_front(subject: Subject, up: Vectors) -> tuple[Vectors, bool]:
    """Return (3,) where the front of a thing upright along `up` (3,) is, and whether that is sure.

    It is along its mirror, where the detail is.
    """
    unlike, normals = _mirrors(subject.at, up)
    best = int(unlike.argmin())
    ahead, others = np.cross(up, normals[best]), np.abs(normals @ normals[best]) < SAME
    along = subject.at @ ahead
    more = np.average(along, weights=subject.detail + SMALLEST) - along.mean()
    sure = unlike[others].min() > MIRRORED * unlike[best] and abs(more) > DETAILED * along.std()
    return np.asarray(ahead if more >= 0 else -ahead), bool(sure)


def _mirrors(at: Vectors, up: Vectors) -> tuple[Vectors, Vectors]:
    """Return how much both sides of mirrors that contain `up` differ, as a distance, and (H, 3) their normals."""
    (a, b), headings = _across(up), np.radians(np.arange(0, 180, 10))[:, None]
    normals = np.cos(headings) * a + np.sin(headings) * b
    away = at @ normals.T
    middles = np.quantile(away, [0.01, 0.99], axis=0).mean(axis=0)
    some = slice(None, None, max(1, len(at) // 300))
    images = at[some, None] - 2 * (away[some] - middles)[..., None] * normals
    return KDTree(at).query(images)[0].mean(axis=0), normals


def _across(up: Vectors) -> Vectors:
    return np.asarray(np.linalg.svd(up[None])[2][1:])


def find_floor(gaussians: Gaussians) -> Vectors | None:
    """Return the direction (3,) that is up where rows stand on a floor, of length 1; None without a floor.

    The thin axis of a flat row is the normal of the surface that it lies in. `gaussians` are repaired.
    """
    g = gaussians.take(np.sort(np.random.default_rng(0).permutation(len(gaussians))[:10_000]))
    areas = surfaces(g)
    normals = to_matrices(g.quaternions)[np.arange(len(g)), :, np.argmin(g.log_scales, axis=1)].astype(np.float64)
    weights = areas * flatness(g)
    tried = spiral(400)  # 10 degrees apart
    commonest = tried[np.argmax((np.abs(normals @ tried.T) > CONE).T @ weights)]
    near = np.abs(normals @ commonest) > CONE
    up = np.linalg.eigh((normals[near] * weights[near, None]).T @ normals[near])[1][:, -1]
    heights = g.means.astype(np.float64) @ up
    lying = np.abs(normals @ up) > CONE
    low, high = _heaviest_slab(heights[lying], weights[lying], heights)
    share = float(weights[lying & (heights >= low) & (heights < high)].sum()) / max(float(areas.sum()), SMALLEST)
    margin = 2 * (high - low)
    below, above = float(areas[heights < low - margin].sum()), float(areas[heights >= high + margin].sum())
    if share < 0.15 or max(below, above) < 3 * min(below, above):
        return None
    return np.asarray(up if above > below else -up)


def flatness(gaussians: Gaussians) -> NDArray[np.float32]:
    """Return (N,) 0 for rows that are needles or balls, 1 for discs."""
    scales = np.sort(gaussians.log_scales, axis=1)
    return (1 - np.exp(scales[:, 0] - scales[:, 1])) ** 2


def _heaviest_slab(values: Vectors, weights: Vectors, heights: Vectors) -> tuple[float, float]:
    """Return the interval with the most weight of `values` that is 3 % of the extent of `heights` wide."""
    low, high = np.quantile(heights, [0.001, 0.999])
    finest = 4 * np.spacing(max(abs(low), abs(high), np.finfo(np.float32).tiny))  # the edges differ
    step = max(0.03 * (high - low) / 2, finest)
    edges = np.arange(low - 2 * step, high + 3 * step, step)
    halves = np.histogram(values, edges, weights=weights)[0]
    best = int(np.argmax(halves[:-1] + halves[1:]))
    return float(edges[best]), float(edges[best + 2])
