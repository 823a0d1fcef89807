"""What errors in channels, and updates that are withheld, cost in pictures. N rows, T frames, C colour channels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding.motion import motion_units
from airgs_codec.package.layout import COLOUR, STATE
from airgs_codec.package.tables import STATE_ATTRIBUTES, StateSteps


def channel_weights(
    classes: NDArray[np.int16], sensitivity: NDArray[np.float64], steps: StateSteps, transform: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(10 + C, N) what an error of one step in a state channel adds to the mean squared error of pictures.

    `sensitivity` (6, N): mean squared derivatives of pictures by each of STATE_ATTRIBUTES, summed over its channels.
    Derivatives by the channels of one attribute are taken to be equal, and errors of different channels independent.
    Colour channel k changes SH DC and SH rest by the entries of row k of the KLT `transform` (C, C).
    """
    unit = motion_units(classes).astype(np.float64) * steps.means
    colours = len(transform)
    dc, rest = (np.square(part).sum(axis=1) for part in (transform[:, :3], transform[:, 3:]))
    by = dict(zip(STATE_ATTRIBUTES, sensitivity, strict=True))
    weights = np.empty((STATE.width(colours), len(classes)))
    weights[STATE.slice("means")] = by["means"] * unit**2 / 3
    weights[STATE.slice("log_scales")] = by["log_scales"] * steps.log_scales**2 / 3
    weights[STATE.slice("quaternions")] = by["quaternions"] * steps.quaternions**2 / 3
    weights[STATE.slice("opacity")] = by["opacity"] * steps.opacity**2
    weights[STATE.slice(COLOUR)] = np.outer(dc, by["sh_dc"] * steps.sh_dc**2 / 3)
    if colours > 3:
        weights[STATE.slice(COLOUR)] += np.outer(rest, by["sh_rest"] * steps.sh_rest**2 / (colours - 3))
    return weights


def withheld_error(changes: NDArray[np.float64], weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N,) mean squared error over all pixels and frames when changes (T, 10 + C, N), in steps, are not sent."""
    return np.einsum("tcn,tcn,cn->n", changes, changes, weights, optimize=True) / len(changes)
