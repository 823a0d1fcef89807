"""The .ply that Spacetime Gaussians saves, the lite model: INRIA's properties with motion, turns and temporal widths.

Told from INRIA's by trbf_center. f_dc_0 to 2 are plain RGB here, motion_0 to 2 the first power of time, and
trbf_scale is a logarithm. The full model has further features, whose colours only its network knows: it is refused.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from airgs_codec.errors import SceneError
from airgs_codec.scene.formats.clip import Bake, Clip
from airgs_codec.scene.formats.spacetime import Spacetime, open_spacetime
from airgs_codec.scene.gaussians import sigmoid
from airgs_codec.scene.ply_elements import Header, read_columns, read_header

_SIGN = "trbf_center"
_GROUPS = (
    ("x", "y", "z"),
    tuple(f"motion_{i}" for i in range(9)),
    tuple(f"rot_{i}" for i in range(4)),
    tuple(f"omega_{i}" for i in range(4)),
    tuple(f"scale_{i}" for i in range(3)),
    ("opacity",),
    tuple(f"f_dc_{i}" for i in range(3)),
    (_SIGN,),
    ("trbf_scale",),
)
_NETWORK = ("f_t_0", "f_dc_3")


def is_spacetime_ply(header: Header) -> bool:
    """Whether a .ply is of this format."""
    vertex = header.element("vertex")
    return vertex is not None and any(p.name == _SIGN for p in vertex.properties)


def open_spacetime_ply(path: Path, bake: Bake) -> Clip:
    """The frames of a file. Raises SceneError."""
    return open_spacetime(path, read_spacetime_ply, "Spacetime Gaussians .ply", bake)


def read_spacetime_ply(path: Path) -> Spacetime:
    """The model of a file. Raises SceneError."""
    header = read_header(path)
    vertex = header.element("vertex")
    names = {p.name for p in vertex.properties} if vertex else set()
    if missing := [name for group in _GROUPS for name in group if name not in names]:
        raise SceneError(f"{path}: expected the properties of Spacetime Gaussians, missing {', '.join(missing)}")
    if not names.isdisjoint(_NETWORK):
        raise SceneError(f"{path}: expected Spacetime Gaussians of the lite model, got colours of a network")
    if vertex is None or not vertex.count:
        raise SceneError(f"{path}: expected at least one Gaussian, got none")
    columns = read_columns(path, header, vertex, _GROUPS)
    means, motion, quaternions, turns, log_scales, logits, rgb, centres, log_widths = columns
    with np.errstate(over="ignore"):
        widths = np.exp(log_widths[:, 0])
    alpha = sigmoid(logits[:, 0])
    return Spacetime(means, motion.reshape(-1, 3, 3), quaternions, turns, log_scales, alpha, rgb, centres[:, 0], widths)
