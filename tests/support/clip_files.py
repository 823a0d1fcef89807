"""Clips as others write them: .4dgs and .splat4d by their libraries, all others by their specifications."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import fourdgs
import numpy as np
from fourdgs.keyframe_delta_file import write_sequence
from fourdgs.keyframe_delta_writer import Sample
from numpy.typing import NDArray

import airgs_codec as airgs
from tests.faces import SH_C0, Gaussians
from tests.support.ply import Column, ply_bytes

WIDTH = 64  # texels of a .splatv, where splaTV has 4096
ROW = np.dtype([
    ("mean", "<f4", 3), ("quaternion", "<f2", 4), ("scale", "<f2", 3), ("unused_1", "<f2"), ("rgba", "u1", 4),
    ("motion", "<f2", (3, 3)), ("unused_2", "<f2"), ("turn", "<f2", 4), ("centre", "<f2"), ("width", "<f2"),
])  # fmt: skip


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
    vertex = []
    for name, column in columns.items():
        several = list(name) if name == "xyz" else [f"{name}{i}" for i in range(column.shape[-1])]
        names = [name] if column.ndim == 1 else several
        vertex += [Column(n, "float", c) for n, c in zip(names, np.reshape(column, (len(rows), -1)).T, strict=True)]
    path.write_bytes(ply_bytes({"vertex": vertex}, "binary_little_endian"))
    return path


def write_splat4d(path: Path, frames: Sequence[Gaussians], fps: int) -> NDArray[np.uint32]:
    """A .splat4d; (N,) the rows of the Gaussians that its rows are."""
    folder = path.with_suffix("")
    folder.mkdir()
    for number, g in enumerate(frames):
        airgs.write(g, folder / f"frame_{number:04d}.splat")
    command = str(Path(sys.executable).with_name("splat4d"))
    words = ["encode", "-i", folder, "-o", path, "--fps", fps, "--gop", 3, "--perm-out", folder / "order"]
    subprocess.run([command, *map(str, words)], check=True, capture_output=True)
    return np.fromfile(folder / "order", "<u4")


def gaussian_set(g: Gaussians, seconds: float, sh_codes: NDArray[np.uint8] | None = None) -> fourdgs.GaussianSet:
    """Gaussians that stand still for some seconds and hardly fade."""
    n = len(g)
    unit = g.quaternions / np.linalg.norm(g.quaternions, axis=1, keepdims=True)
    rgba = np.concatenate([np.clip(g.sh_dc * SH_C0 + 0.5, 0, 1), g.opacities()[:, None]], axis=1)
    still, zero = np.zeros((n, 3), np.float32), np.zeros(n, np.float32)
    times = (zero, np.full(n, 1000, np.float32), np.zeros(n), np.full(n, seconds))
    more = {} if sh_codes is None else {"sh": sh_codes, "sh_degree": {9: 1, 24: 2, 45: 3}[sh_codes.shape[1]]}
    return fourdgs.GaussianSet(g.means, np.exp(g.log_scales), unit[:, [1, 2, 3, 0]], rgba, still, *times, **more)


def numbered_4dgs(frames: Sequence[tuple[Gaussians, NDArray[np.int64]]], fps: int) -> bytes:
    seconds = len(frames) / fps
    samples = [Sample(i / fps, ids, gaussian_set(g, seconds)) for i, (g, ids) in enumerate(frames)]
    return bytes(write_sequence(samples, seconds))
