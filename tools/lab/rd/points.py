"""Points of rate-distortion curves, and the mean distance between two curves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator


@dataclass(frozen=True, slots=True)
class RdPoint:
    coder: str
    setting: str
    kb_per_frame: float
    psnr: float  # dB, against renderings of the input
    truth_psnr: float | None  # dB, against pictures taken of the scene
    encode_s: float
    decode_s: float


def curves(points: Sequence[RdPoint]) -> dict[str, list[RdPoint]]:
    """The points of each coder in order of rate; coders in order of their first point."""
    names = dict.fromkeys(p.coder for p in points)
    return {name: sorted((p for p in points if p.coder == name), key=lambda p: p.kb_per_frame) for name in names}


def bd_rate(ours: Sequence[RdPoint], theirs: Sequence[RdPoint], low: float = 0.0, high: float = 99.0) -> float | None:
    """Bjontegaard's mean difference of log rate over the PSNR in [low, high] that both curves cover, as a share.

    Log rate is interpolated over PSNR by monotone cubics, never beyond a curve's ends. Points that another of the same
    curve beats at fewer bytes are left out: a rate curve must rise. None under 4 points, or where nothing is common.
    """
    rising = [_rising(points) for points in (ours, theirs)]
    if min(len(c) for c in rising) < 4:
        return None
    low = max(low, *(c[0].psnr for c in rising))
    high = min(high, *(c[-1].psnr for c in rising))
    if high <= low:
        return None
    means = []
    for curve in rising:
        fit = PchipInterpolator([p.psnr for p in curve], [np.log(p.kb_per_frame) for p in curve])
        means.append(float(fit.integrate(low, high)) / (high - low))
    return float(np.expm1(means[0] - means[1]))


def kb_at(curve: Sequence[RdPoint], psnr: float) -> float | None:
    """kB a frame at which a curve reaches a PSNR in dB, log rate on straight lines over PSNR; None beyond its ends."""
    rising = _rising(curve)
    if len(rising) < 2 or not rising[0].psnr <= psnr <= rising[-1].psnr:
        return None
    return float(np.exp(np.interp(psnr, [p.psnr for p in rising], [np.log(p.kb_per_frame) for p in rising])))


def _rising(points: Sequence[RdPoint]) -> list[RdPoint]:
    kept: list[RdPoint] = []
    for point in sorted(points, key=lambda p: p.kb_per_frame):
        if not kept or point.psnr > kept[-1].psnr:
            kept.append(point)
    return kept
