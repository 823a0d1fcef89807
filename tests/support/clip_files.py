"""Clips as others write them: .4dgs and .splat4d by their libraries, all others by their specifications."""

from __future__ import annotations

import io
import json
import subprocess
import sys
import wave
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import fourdgs
import numpy as np
from fourdgs.keyframe_delta_file import write_sequence
from fourdgs.keyframe_delta_writer import Sample
from numpy.typing import NDArray

from airgs_codec.media.image import encode_webp
from airgs_codec.scene.formats.form import Losses
from airgs_codec.scene.formats.ply_elements import write_floats
from airgs_codec.scene.formats.spacetime import ROW
from airgs_codec.scene.formats.splat import SPLAT, write_splat
from airgs_codec.scene.gaussians import SH_C0, Gaussians

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


def write_splat4d(path: Path, frames: Sequence[Gaussians], fps: int) -> NDArray[np.uint32]:
    """A .splat4d; (N,) the rows of the Gaussians that its rows are."""
    folder = path.with_suffix("")
    folder.mkdir()
    for number, g in enumerate(frames):
        write_splat(folder / f"frame_{number:04d}.splat", Losses(SPLAT.holds, ".splat").fit(g, "frame"))
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
    """A .4dgs of states whose Gaussians have numbers (N,)."""
    seconds = len(frames) / fps
    samples = [Sample(i / fps, ids, gaussian_set(g, seconds)) for i, (g, ids) in enumerate(frames)]
    return bytes(write_sequence(samples, seconds))


def tsog_bytes(change: Callable[[dict[str, Any]], object] = lambda meta: None, **more: bytes) -> bytes:
    """A .tsog of two Gaussians by the specification, the values of which are worked out by hand.

    They are at (-1, 0, 1) and (1, 0, 1) at the times 0.25 and 0.75, go (2, 0, 0) and (-2, 0, 0) in the whole time with
    a deviation of 0.5, have sizes of 1, no rotation, alpha 128/255 and 1. `change` edits its meta.json; `more`: further
    files, and pictures in place of its own (H, W, 4).
    """
    log2 = float(np.log(2))
    meta: dict[str, Any] = {
        "version": 4,
        "profile": {"id": "org.opsiclear.tsog-playback", "version": 1},
        "count": 2,
        "means": {"mins": [-log2, 0, log2], "maxs": [log2, 0, log2], "files": ["low", "high"]},
        "scales": {"codebook": [0], "files": ["sizes"]},
        "quats": {"files": ["quats"]},
        "sh0": {"codebook": [0, 1, -1], "files": ["dc"]},
        "shN": {"bands": 1, "count": 2, "codebook": [0, 0.5, -0.5], "files": ["palette", "labels"]},
        "timeline": {"type": 1, "mins": [0.25, 0.5], "maxs": [0.75, 0.5], "files": ["t_low", "t_high"]},
        "temporal": {"means": {"mins": [[-2, 0, 0]], "maxs": [[2, 0, 0]], "files": ["v"]}},
        "playback": {"duration": 2, "fps": 2},
    }
    ends = [[0, 0, 0, 255], [255, 0, 0, 255]]
    palette = np.full((1, 192, 4), 255, np.uint8)
    palette[0, :6, :3] = [[1, 2, 0]] * 3 + [[2, 0, 1]] * 3
    palette[0, 6:, :3] = 0
    pixels = {
        **dict.fromkeys(("low", "high", "t_low", "t_high"), ends),
        "sizes": [[0, 0, 0, 255]] * 2,
        "quats": [[128, 128, 128, 252], [128, 128, 128, 255]],
        "dc": [[0, 1, 2, 128], [2, 0, 1, 255]],
        "palette": palette[0],
        "labels": [[0, 0, 9, 255], [1, 0, 0, 255]],
        "v": [[255, 0, 0, 255], [0, 0, 0, 255]],
    }
    files = {name: encode_webp(np.array([rows], np.uint8)) for name, rows in pixels.items()} | more
    change(meta)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr("meta.json", json.dumps(meta))
        for name, data in files.items():
            archive.writestr(name, data)
    return out.getvalue()


def discrete(frames: int, **playback: float) -> Callable[[dict[str, Any]], object]:
    """The change of `tsog_bytes` to a discrete file: its Gaussians are in the first and the last frame."""
    line = {"type": 0, "N": frames, "delta": 65536 // frames, "files": ["t_low", "t_high"]}
    return lambda meta: meta.update(timeline=line, playback=playback)


def tone(seconds: float) -> bytes:
    """A file of sound: 440 Hz as WAV of 16 bits."""
    out = io.BytesIO()
    with wave.open(out, "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(16000)
        time = np.arange(round(16000 * seconds)) / 16000
        file.writeframes((3000 * np.sin(2 * np.pi * 440 * time)).astype("<i2").tobytes())
    return out.getvalue()


def write_ftgs(path: Path, degree: int = 1, **settings: object) -> Path:
    """An FTGS .ply of four Gaussians by its FORMAT.md, its properties in another order than usual.

    Number n is at (n, 0, 0) at time 0.5, goes (2, 0, 0) in the whole time with a deviation of 0.1; f_rest_i is i + 1.
    `settings`: other comments, None for one that is left out.
    """
    said = {"ftgs_version": 1, "time_units": "normalized", "sh_degree": degree, "use_velocity": 1}
    said |= {"min_duration": 0.02, "opacity_floor": 0.0001} | settings
    rest = 3 * ((degree + 1) ** 2 - 1)
    columns = {"velocity_0": 2.0, "velocity_1": 0.0, "velocity_2": 0.0, "log_duration": np.log(0.1), "time": 0.5}
    columns |= {"rot_0": 1.0, "rot_1": 0.0, "rot_2": 0.0, "rot_3": 0.0, "opacity": 0.0}
    columns |= {f"scale_{i}": np.log(i + 1.0) for i in range(3)} | {f"f_rest_{i}": i + 1.0 for i in range(rest)}
    columns |= {f"f_dc_{i}": 0.1 * i for i in range(3)} | {"z": 0.0, "y": 0.0, "x": 0.0}
    table = np.tile(np.array(list(columns.values()), "<f4"), (4, 1))
    table[:, -1] = np.arange(4)
    lines = ["ply", "format binary_little_endian 1.0"]
    lines += [f"comment {name} {value}" for name, value in said.items() if value is not None]
    lines += ["element vertex 4", *(f"property float {name}" for name in columns), "end_header", ""]
    path.write_bytes("\n".join(lines).encode() + table.tobytes())
    return path
