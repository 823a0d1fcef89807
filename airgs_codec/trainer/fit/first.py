"""The fit of a first frame, from points alone (AirGS, "Training" 1). N Gaussians, P points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from airgs_codec.progress import Progress, silent
from airgs_codec.scene.camera import Camera
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.trainer.data.multiview import Points
from airgs_codec.trainer.fit.grow import Densifier
from airgs_codec.trainer.fit.losses import ExposureModel
from airgs_codec.trainer.fit.optimise import optimise
from airgs_codec.trainer.fit.parameters import InMotion, from_gaussians, to_moving, with_motion
from airgs_codec.trainer.fit.points import from_points, initial_points
from airgs_codec.trainer.fit.surround import sparse_cloud
from airgs_codec.trainer.fit.trainer import FrameViews, Trainer
from airgs_codec.trainer.fit.variables import PerGaussian, Rates, Regularisers
from airgs_codec.trainer.settings import BUDGET, LEAST_BUDGET, MOST_BUDGET

START_OPACITY = 0.1  # of the points that a first frame starts from
RANDOM_SHARE = 0.3  # of the budget: points to begin with; random ones fill up
# Empty space stays empty. Against no weights +0.3 dB in held-out views of a first frame of the fox; a weight of 0.1 in
# place of 0.03 on scales gave basketball 0.2 dB in two splits of its cameras (0.5 with their exposure matched).
FIRST_REGULARISERS = Regularisers(opacity=0.003, scale=0.1)
# Few cameras that are far apart leave much of a scene free: what is known of its surfaces is opaque, and stays there.
SPARSE_OPACITY = 0.6
SPARSE_RATES = Rates(means=0.1)
DROPOUT = 0.2
UNSEEN_OPACITY = 0.95
# More gave basketball, of 640 x 360 pixels, 0.8 dB in held-out views, and the fox, of 320 x 320, 0.2 to 0.4 for twice
# as many; in a sparse rig they showed less.
GAUSSIAN_PIXELS = 14  # of a picture, for each Gaussian
SH_SHARE = 0.25  # of the iterations until each further SH band joins


def fit_first(
    trainer: Trainer,
    target: FrameViews,
    points: Points | None,
    exposure: ExposureModel | None = None,
    progress: Progress = silent,
) -> InMotion:
    """3DGS from a cloud of points (AirGS, "Training" 1), within the budget where the settings keep to one.

    `points`: the cloud; None to find one in the pictures. `exposure`: gains and offsets of the views' cameras,
    which are fitted too. Raises SceneError where there is nothing to start from, TrainingError where the loss is
    not finite or no Gaussian is left.
    """
    s = trainer.settings
    rng = trainer.rng(target.frame, 0)
    within = s.densify == BUDGET
    sparse = sparse_cloud(points, target.views, s.budget or LEAST_BUDGET, rng) if within else None
    few = s.budget or (LEAST_BUDGET if sparse else usual_budget([view.camera for view in target.views]))
    fewest, most = (round(RANDOM_SHARE * few), few) if within else (0, trainer.capacity)
    cloud = sparse.points if sparse else initial_points(points, target.views, fewest, rng)
    assert cloud.colours is not None  # both give every point one
    if sparse:
        most -= len(sparse.unseen.positions)
    chosen = np.sort(rng.permutation(len(cloud.positions))[:most])
    opacity, largest = SPARSE_OPACITY if sparse else START_OPACITY, 0.1 * trainer.extent
    start = from_points(cloud.positions[chosen], cloud.colours[chosen], s.sh_degree, opacity, largest)
    variables = PerGaussian(
        with_motion(from_gaussians(start, trainer.device), target.views),
        trainer.extent,
        SPARSE_RATES if sparse else Rates(),
        regularisers=FIRST_REGULARISERS if s.regularised else Regularisers(),
        dropout=DROPOUT if sparse else 0.0,
        seed=s.seed,
        densifier=Densifier(trainer.growth(most, target.views), len(start), rng),
        clears=trainer.clears(target.views),
    )
    iterations = s.iterations_from_scratch(len(target.views))
    schedule = trainer.schedule("first frame", iterations, lambda done: min(s.sh_degree, int(done / SH_SHARE)))
    optimise(variables, [*target.views, *target.later], schedule, rng, exposure, progress)
    variables.remove_fainter(trainer.least_opacity)
    found = replace(to_moving(variables.detached()), cleared=variables.cleared)
    if not (sparse and len(sparse.unseen.positions)):
        return found
    places, colours = sparse.unseen.positions, sparse.unseen.colours
    assert colours is not None
    unseen = from_points(places, colours, s.sh_degree, UNSEEN_OPACITY, largest)
    motion = None if found.velocity is None else np.pad(found.velocity, ((0, len(unseen)), (0, 0)))
    return replace(found, gaussians=Gaussians.join([found.gaussians, unseen]), velocity=motion)


def usual_budget(cameras: Sequence[Camera]) -> int:
    """Gaussians of a first frame that cameras see, where nobody says how many: as many as their pictures can tell."""
    pixels = float(np.mean([camera.width * camera.height for camera in cameras]))
    return round(min(max(LEAST_BUDGET, pixels / GAUSSIAN_PIXELS), MOST_BUDGET))
