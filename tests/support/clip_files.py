"""Clips as others write them: Spacetime Gaussians as .splatv and as .ply."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec.scene.formats.splatv import ROW
from airgs_codec.scene.ply_elements import write_floats

WIDTH = 64  # texels of a .splatv, where splaTV has 4096


def random_rows(count: int, seed: int = 0) -> NDArray[np.void]:
    """Rows of a .splatv whose Gaussians move, turn, appear and fade."""
    rng = np.random.default_rng(seed)
    rows = np.zeros(count, ROW)
    rows["mean"] = rng.normal(size=(count, 3)) * 0.5
    rows["quaternion"] = rng.normal(size=(count, 4))
    rows["scale"] = np.exp(rng.normal(size=(count, 3)) * 0.4 - 2.5)
    rows["rgba"] = rng.integers(1, 255, (count, 4))
    rows["motion"] = rng.normal(size=(count, 3, 3)) * 0.1
    rows["turn"] = rng.normal(size=(count, 4)) * 0.2
    rows["centre"] = rng.uniform(0, 1, count)
    rows["width"] = rng.uniform(0.3, 2, count)
    return rows


def splatv_bytes(rows: NDArray[np.void], *, cameras: tuple[object, ...] = (), **chunk: object) -> bytes:
    """A .splatv; `chunk`: other values in its header."""
    height = -(-len(rows) * 4 // WIDTH)
    head = {"type": "splat", "size": WIDTH * height * 16, "texwidth": WIDTH, "texheight": height, "cameras": cameras}
    text = json.dumps([head | chunk]).encode()
    return b"\x4b\x67\0\0" + len(text).to_bytes(4, "little") + text + rows.tobytes()


def write_spacetime_ply(path: Path, rows: NDArray[np.void], *more: str) -> Path:
    """The same Gaussians as the .ply of the model that was trained; `more`: further properties, all 0."""
    alpha = rows["rgba"][:, 3] / 255
    columns = {
        "xyz": rows["mean"],
        "trbf_center": rows["centre"],
        "trbf_scale": np.log(rows["width"].astype(np.float64)),
        "n": np.zeros((len(rows), 3)),
        "motion_": rows["motion"].reshape(-1, 9),
        "f_dc_": rows["rgba"][:, :3] / 255,
        "opacity": np.log(alpha / (1 - alpha)),
        "scale_": np.log(rows["scale"].astype(np.float64)),
        "rot_": rows["quaternion"],
        "omega_": rows["turn"],
    } | {name: np.zeros(len(rows)) for name in more}
    names: list[str] = []
    for name, column in columns.items():
        several = [f"{name}{i}" for i in range(column.shape[-1])]
        names += list(name) if name == "xyz" else [name] if column.ndim == 1 else several
    table = np.concatenate([np.reshape(c, (len(rows), -1)) for c in columns.values()], axis=1).astype(np.float32)
    with path.open("wb") as file:
        write_floats(file, names, iter([table]), len(rows))
    return path
