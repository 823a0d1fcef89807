"""What hangs in the open space about cameras: what only far ones see may stand anywhere before what they look at.

Viewers stand where cameras do, and between them. N Gaussians, P places.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from airgs_codec.render.backend import CPU, Renderer
from airgs_codec.scene.camera import BLACK, Camera, resized
from airgs_codec.scene.gaussians import SH_C0, Gaussians
from airgs_codec.trainer.fit.points import neighbours, project

CHECKS = (0.3, 0.5, 0.7, 0.9)  # shares of the iterations of a fit at which it is removed: what stays fills in for it
NEARER = 4.0  # times as near as any camera that sees it may a viewer come to a Gaussian
BEHIND = 0.25  # of its distance from a viewer, by which cameras see past what hangs free
ONE_WAY = 0.99  # length of the mean direction to the cameras that see it, from which they tell no depth: 8° off it
SEEN = 0.1  # of its opacity, with which a camera sees it
AROUND = 3  # cameras about each one, to which viewers may go
SHRUNK = 0.5  # pictures that tell it have this share of their pixels on either side


def in_open_space(g: Gaussians, cameras: Sequence[Camera], renderer: Renderer = CPU) -> NDArray[np.bool_]:
    """(N,) rows that no camera sees from as near as viewers may be, and that are seen from one side, or seen past.

    At what depth a thing is that one camera sees, or two beside each other, pictures hardly tell: the fit puts it
    elsewhere as well.
    """
    loaded, opacities, means = renderer.load(g), g.opacities(), g.means.astype(np.float64)
    nearest, (behind, weight, count) = np.full(len(g), np.inf), np.zeros((3, len(g)))
    towards = np.zeros((len(g), 3))
    for camera in (resized(camera, SHRUNK) for camera in cameras):
        found = loaded.contribution(camera)
        depths = means @ camera.world_to_camera[2, :3] + camera.world_to_camera[2, 3]
        colours = np.repeat(((depths - 0.5) / SH_C0).astype(np.float32)[:, None], 3, axis=1)
        picture = renderer.render(replace(g, sh_dc=colours, sh_rest=g.sh_rest[:, :0]), camera, BLACK)
        rows, columns, inside = project(camera, means)
        opaque = np.maximum(1 - picture.transmittance, np.finfo(np.float32).eps)
        past = (picture.rgb[..., 0] / opaque)[rows, columns] - depths[inside]
        behind[inside] += found.total[inside] * past
        weight[inside] += found.total[inside]
        seen, drawn = found.peak > SEEN * opacities, found.hits > 0
        to = camera.position - means
        distances = np.linalg.norm(to, axis=1)
        nearest[seen] = np.minimum(nearest, distances)[seen]
        count += drawn
        towards[drawn] += (to / distances[:, None])[drawn]
    away = cKDTree(_places(cameras)).query(means)[0]
    one_way = np.linalg.norm(towards, axis=1) > ONE_WAY * count
    return np.isfinite(nearest) & (nearest > NEARER * away) & (one_way | (behind > BEHIND * away * weight))


def _places(cameras: Sequence[Camera]) -> NDArray[np.float64]:
    """(P, 3) where viewers may be: at cameras, and between neighbours."""
    at = np.stack([camera.position for camera in cameras])
    between = [(at[a] + at[b]) / 2 for a, b in neighbours(cameras, AROUND)]
    return np.concatenate([at, np.reshape(between, (-1, 3))])
