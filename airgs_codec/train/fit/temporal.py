"""L_temp: what a change costs, counted in the steps the codec will code it with. N Gaussians.

The paper's sum of |d| has no unit and no reduction (AirGS, "Training" 2): summed over raw values its 1e-3 stops all
motion, averaged it does nothing. Here it is the mean over Gaussians of |d|_1 with every channel in units of the codec's
step: weight * mean_i sum_c |d_ic| / step_ic.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch

from airgs_codec.analysis.sensitivity import measure_sensitivity
from airgs_codec.coding.motion import classify_motion, motion_units
from airgs_codec.coding.steps import StepSettings
from airgs_codec.render import Camera
from airgs_codec.render.backend import CPU, Renderer
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.train.fit.parameters import ATTRIBUTES, Parameters
from airgs_codec.train.settings import Temporal

# The derivative of alpha by its logit is taken to be at least this: near 0 and 1 a step of alpha is no finite logit.
LEAST_SLOPE = 0.02


def temporal_weights(temporal: Temporal, steps: Mapping[str, torch.Tensor]) -> Parameters:
    """Weight of |d| of every element, from the codec step of each."""
    if temporal.unit == "raw":
        return {name: torch.full_like(step, temporal.weight) for name, step in steps.items()}
    return {name: temporal.weight / (len(step) * step) for name, step in steps.items()}


def codec_steps(
    g: Gaussians, cameras: Sequence[Camera], steps: StepSettings | None = None, renderer: Renderer = CPU
) -> Parameters:
    """One codec step for every element of the stored attributes, to first order, where the Gaussians are now.

    Means: the row's motion unit, by how much pictures depend on it. Quaternions: half the rotation's step, as a small
    rotation w changes a unit quaternion by w / 2. Opacity: the step of alpha over alpha's derivative by the logit.
    """
    state = (steps or StepSettings()).state
    sensitivity = measure_sensitivity([g], cameras, renderer)
    unit = motion_units(classify_motion(sensitivity.means, g))
    alpha = g.opacities()
    length = np.linalg.norm(g.quaternions.astype(np.float64), axis=1, keepdims=True)
    table = {
        "means": np.broadcast_to((unit * state.means)[:, None], g.means.shape),
        "quaternions": np.broadcast_to(state.quaternions / 2 * np.maximum(length, 1e-12), g.quaternions.shape),
        "log_scales": np.full(g.log_scales.shape, state.log_scales),
        "opacity_logits": state.opacity / np.maximum(alpha * (1 - alpha), LEAST_SLOPE),
        "sh_dc": np.full(g.sh_dc.shape, state.sh_dc),
        "sh_rest": np.full(g.sh_rest.shape, state.sh_rest),
    }
    return {name: torch.from_numpy(np.ascontiguousarray(table[name], np.float32)) for name in ATTRIBUTES}


def static_shares(before: Gaussians, after: Gaussians, steps: Parameters) -> dict[str, float]:
    """Share of each attribute's channels that changed by less than half a codec step, over the rows of `before`."""
    shares = {}
    for name in ATTRIBUTES:
        old, new = getattr(before, name), getattr(after, name)[: len(before)]
        if old.size:
            half = steps[name].cpu().numpy()[: len(before)] / 2
            shares[name] = float(np.mean(np.abs(new - old) < half))
    return shares
