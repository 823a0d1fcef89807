"""Stiff cases that a package has: Gaussians whose numbers lie at their ends, and the bound that holds for them."""

from __future__ import annotations

import numpy as np

from airgs_codec.decoder.decode import decode
from airgs_codec.package.layout import DELTA, KEYFRAME
from airgs_codec.package.package import Package

NEEDLE = 100  # times as long as thin
CLEAR, SOLID = 1 / 255, 0.99  # of α: a picture of 8 bits shows less; its logit grows without end
WIDE = 1e4  # sizes from the middle


def stiff_cases(package: Package) -> list[str]:
    """Return a line for each case in the first two frames of the middle group, at the top rung.

    Bounds are the `max_error` of the group's tables (FORMAT.md, section 4). Raises FormatError, OSError.
    """
    m = package.manifest
    group = m.groups[len(m.groups) // 2]
    g, later = (decode(package, min(group.start + i, group.stop - 1)) for i in range(2))
    bounds = dict.fromkeys(DELTA.attributes, 0.0)
    for attributes, tables in (
        (DELTA.attributes, [group.levels[0]]),
        (DELTA.attributes if group.base else KEYFRAME.attributes, [tier.qualities[0] for tier in group.tiers]),
    ):
        for table in tables:
            for name, bound in zip(attributes, table.max_error, strict=True):
                bounds[name] = max(bounds[name], bound)
    size = np.exp(g.log_scales.max(axis=1))
    thin = np.ptp(g.log_scales, axis=1) > np.log(NEEDLE)
    ends = (g.opacities() < CLEAR) | (g.opacities() > SOLID)
    moved = np.linalg.norm(later.means - g.means, axis=1) > size if len(later) == len(g) else np.zeros(len(g), bool)
    away = np.linalg.norm(g.means - np.median(g.means, axis=0), axis=1) > WIDE * np.median(size)
    cases = [
        (thin, f"over {NEEDLE} times as long as thin; sizes are right to {100 * np.expm1(bounds['log_scales']):.0f} %"
               f", axes to {bounds['quaternions']:.2g} radians"),
        (ends, f"hardly seen or almost solid; opacity is right to {bounds['opacity']:.2g}"),
        (moved, f"moving by more than their size in a frame; positions are right to {bounds['means']:.2g} "
                "of a motion unit"),
        (away, f"over {WIDE:,.0f} sizes from the middle; positions are right to {group.grid.step / 2:.2g} units"),
    ]  # fmt: skip
    return [f"{found.sum():,} of {len(found):,} Gaussians are {words}" for found, words in cases if found.any()]
