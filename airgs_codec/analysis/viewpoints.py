"""Where a scene that comes without cameras is meant to be seen from.

Three answers. An object whose surroundings are empty is seen from all sides, or from above the floor it stands on. A
filmed place is seen from where pictures of it look like pictures (`viewpoint_score`), which a search finds. Where
neither is clear, the answer says so, and its cameras are the best guesses and views from all sides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from airgs_codec.analysis.floor import find_floor
from airgs_codec.analysis.viewpoint_score import Sample
from airgs_codec.analysis.viewpoint_search import Pose, Search, best_apart, gaps, judge, spread
from airgs_codec.errors import SceneError
from airgs_codec.render import Camera
from airgs_codec.render.cpu import one_thread
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.orbits import UP, dome_views, orbit_views
from airgs_codec.scene.repair import repair

SIZE = 256  # pixels of the cameras
COUNT = 12  # cameras
GUESSES = 8  # cameras of either kind where nothing is sure; the fewest where it is
SIDES, SIDE_SIZE, SIDE_ROWS = 12, 48, 8000  # views, pixels and rows that tell an object from a place
OBJECT = 0.6  # solidity of three in four sides of an object; filmed places have up to 0.5, objects from 0.7
PERHAPS = 0.52  # solidity of what may be either
LOWEST = np.radians(5)  # of views of an object on a floor, above the horizon
SCATTERED, KEPT, ROUNDS = 300, 40, 5  # poses tried at random, those looked at again, rounds about the best of them
GOOD = 0.7  # of the best score
APART = (0.35, 0.2, 0.1)  # of `gaps`, of the poses that cameras are chosen from: the first that leaves enough
REGION = 1.5  # of `gaps`, at most, from one pose of a region to the next
UPRIGHT = np.cos(np.radians(20))  # between the floor's own up and the one that is told
NOTHING_SEEN = "nothing can be seen: 8 views on an orbit"
GUESSED_UP = "; nothing tells which way is up, {} is taken"
SURE = 0.05  # score of the best; real captures have 0.1 to 0.2, broken ones mostly up to 0.03
SURE_COVERED = 0.95  # of most pictures; who films a place fills them, objects with haze about them leave holes

Vector = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class FoundViews:
    """Cameras that stand for all places from which a scene looks good."""

    cameras: list[Camera]
    scores: list[float]  # 0..1 for each camera: of `Look` for a place, solidity for an object, 0 of views all around
    confident: bool  # whether viewers stay near these cameras; else they may be anywhere
    story: str  # a line that says what was found, and how sure it is


def find_viewpoints(frames: Sequence[Gaussians], up: Vector | None = None) -> FoundViews:
    """Find where some frames of a scene are meant to be seen from. The middle one decides, all of them judge.

    8 to 16 square cameras; the same frames give the same cameras. `up` (3,) points up where somebody told
    it; else up is away from the floor under an object, or -y, as structure from motion mostly leaves it. A frame need
    not be repaired; frames need not share rows.

    Raises SceneError when a frame has no finite row.
    """
    usable = [repair([frame], "views").frames[0] for frame in frames]
    middle = usable[len(usable) // 2]
    try:
        with one_thread():
            solidity = _solidity(middle)
            floor = find_floor(middle) if solidity >= OBJECT else None
            upright = up if up is not None else floor if floor is not None else UP
            found = _object(middle, upright, floor) if solidity >= OBJECT else _place(usable, upright, solidity)
    except SceneError:
        floor, upright = None, UP if up is None else up
        found = FoundViews(orbit_views(middle, up=upright), [0.0] * 8, False, NOTHING_SEEN)
    if up is not None:
        return found
    return replace(found, story=found.story + GUESSED_UP.format("-y" if floor is None else "away from the floor"))


def _solidity(gaussians: Gaussians) -> float:
    """Solidity that three in four views from all sides have. Raises SceneError when no row can be seen."""
    sample = Sample.of(gaussians, SIDE_ROWS)
    sides = [sample.solidity(camera) for camera in dome_views(gaussians, SIDES, SIDE_SIZE, UP)]
    return float(np.quantile(sides, 0.25))


def _object(gaussians: Gaussians, up: Vector, floor: Vector | None) -> FoundViews:
    """All around, or over what it stands on, where the floor's own up (3,) is about `up` (3,)."""
    stands = floor is not None and float(floor @ up) > UPRIGHT * np.linalg.norm(up)
    cameras = dome_views(gaussians, COUNT, SIZE, up, LOWEST if stands else -np.pi / 2)
    sample = Sample.of(gaussians, SIDE_ROWS)
    scores = [sample.solidity(camera) for camera in cameras]
    where = "all around it, above its floor" if stands else "all around it"
    return FoundViews(cameras, scores, True, f"an object in empty space: {COUNT} views {where}")


def _place(frames: Sequence[Gaussians], up: Vector, solidity: float) -> FoundViews:
    middle = frames[len(frames) // 2]
    search = Search(middle)
    search.scatter(SCATTERED, KEPT)
    search.refine(ROUNDS)
    ranked = _ranked(search.poses, frames)
    good = _good(ranked)
    doubt = "it may be an object in a haze" if solidity >= PERHAPS else _doubt(good)
    chosen = spread(ranked[: 2 * GUESSES], GUESSES) if doubt else spread(good, COUNT)
    cameras = [pose.camera(f"found{i:02d}", SIZE, up) for i, pose in enumerate(chosen)]
    scores = [pose.look.score for pose in chosen]
    if not doubt:
        return FoundViews(cameras, scores, True, f"a filmed place: {_where(good, len(cameras))}")
    around = dome_views(middle, GUESSES, SIZE, up)
    story = f"unclear where from ({doubt}): {_where(chosen, len(cameras))}, and {len(around)} all around"
    return FoundViews(cameras + around, scores + [0.0] * len(around), False, story)


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
