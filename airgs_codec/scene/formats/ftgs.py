"""FTGS .ply, version 1 (FORMAT.md of OpsiClear-4DGS/ftgs-player): Gaussians of FreeTimeGS, which move evenly and fade.

Of `moving` it has P = 1 and SH, no turns. log_duration is the logarithm of a standard deviation, which a comment of the
header bounds, as one does alpha from below; frame i of F is at i / (F - 1), and the frame rate is the player's choice.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from airgs_codec.errors import SceneError
from airgs_codec.scene.beside import DEFAULT_FPS
from airgs_codec.scene.files import expecting
from airgs_codec.scene.formats.form import MOST_FRAMES, Bake, Clip, ClipFormat, Holds, count_frames
from airgs_codec.scene.formats.moving import MOST_OFF, Moving, baked_note, even_motion, moving_clip
from airgs_codec.scene.formats.ply_elements import Header, read_columns, read_header, write_floats
from airgs_codec.scene.gaussians import SH_REST, Gaussians, logits_of, sigmoid

FRAMES = 300  # of a file that does not say it
_FTGS_SIGN = "log_duration"
_FTGS = (
    ("x", "y", "z"),
    tuple(f"rot_{i}" for i in range(4)),
    tuple(f"scale_{i}" for i in range(3)),
    ("opacity",),
    tuple(f"f_dc_{i}" for i in range(3)),
    ("time",),
    (_FTGS_SIGN,),
    tuple(f"velocity_{i}" for i in range(3)),
)
_FTGS_RANGES = {  # of what the comments must say: least, most, whether it is a whole number
    "sh_degree": (0, 3, True),
    "use_velocity": (0, 1, True),
    "min_duration": (float(np.finfo(np.float32).tiny), float(np.finfo(np.float32).max), False),
    "opacity_floor": (0, float(np.nextafter(np.float32(1), np.float32(0))), False),
}


def is_ftgs(header: Header) -> bool:
    """Return whether a .ply is of FreeTimeGS."""
    vertex = header.element("vertex")
    return vertex is not None and any(p.name == _FTGS_SIGN for p in vertex.properties)


def open_ftgs(path: Path, bake: Bake) -> Clip:
    """A model baked to frames, as many as its header says at 30 a second unless others are asked for.

    Raises SceneError.
    """
    settings = _ftgs_settings(path, read_header(path))
    stated = settings.get("n_frames")
    if stated is not None and not (stated.is_integer() and 1 <= stated <= MOST_FRAMES):
        raise SceneError(f"{path}: expected n_frames of 1 to {MOST_FRAMES}, got {stated:g}")
    length = Fraction(FRAMES if stated is None else int(stated)) / DEFAULT_FPS
    fps, seconds = bake.fps or DEFAULT_FPS, length if bake.seconds is None else bake.seconds
    frames = count_frames(path, fps, seconds)
    clip = moving_clip(read_ftgs, path, frames, fps, max(1, frames - 1))
    return replace(clip, note=baked_note("FTGS .ply", clip, seconds, stated is not None or bake.seconds is not None))


def read_ftgs(path: Path) -> Moving:
    """The model of a file. Raises SceneError."""
    header = read_header(path)
    settings = _ftgs_settings(path, header)
    vertex = header.element("vertex")
    if vertex is None or not vertex.count or header.ascii:
        raise SceneError(f"{path}: expected FTGS, binary rows of at least one Gaussian, got none")
    rest = SH_REST[int(settings["sh_degree"])]
    groups = (*_FTGS, tuple(f"f_rest_{i}" for i in range(3 * rest)))
    names = {p.name for p in vertex.properties}
    if missing := [name for group in groups for name in group if name not in names]:
        raise SceneError(f"{path}: expected the properties of FTGS, missing {', '.join(missing)}")
    means, quaternions, log_scales, logits, dc, centres, log_widths, velocity, sh = read_columns(
        path, header, vertex, groups
    )
    harmonics = np.ascontiguousarray(sh.reshape(len(means), 3, rest).transpose(0, 2, 1))
    with np.errstate(over="ignore"):
        deviations = np.maximum(np.exp(log_widths[:, 0]), np.float32(settings["min_duration"]))
    motion = velocity[:, None] * np.float32(settings["use_velocity"])
    still = Gaussians(means, quaternions, log_scales, logits[:, 0], dc, harmonics)
    alpha, widths = sigmoid(logits[:, 0]), deviations * np.float32(np.sqrt(2))
    return Moving(still, motion, alpha, centres[:, 0], widths, least_alpha=settings["opacity_floor"])


def _ftgs_settings(path: Path, header: Header) -> dict[str, float]:
    """The numbers in the comments of a header. Raises SceneError for one that is missing or out of its range."""
    words = dict(line.split(maxsplit=1) for line in header.comments if len(line.split()) > 1)
    with expecting(path, "FTGS of version 1 in normalized time"):
        if words.get("ftgs_version") != "1" or words.get("time_units") != "normalized":
            got = f"{words.get('ftgs_version')} in {words.get('time_units')} time"
            raise SceneError(f"{path}: expected FTGS of version 1 in normalized time, got {got[:80]}")
        found = {name: float(words[name]) for name in _FTGS_RANGES}
        found |= {"n_frames": float(words["n_frames"])} if "n_frames" in words else {}
    for name, (low, high, whole) in _FTGS_RANGES.items():
        if not low <= found[name] <= high or (whole and not found[name].is_integer()):
            raise SceneError(f"{path}: expected {name} from {low:g} to {high:g}, got {words[name][:40]}")
    return found


def write_ftgs(path: Path, frames: Iterable[Gaussians], _fps: float, _sound: bytes = b"") -> None:
    """Write frames whose Gaussians move evenly and fade, as `even_motion` finds them; all are in memory at once.

    Raises SceneError for frames that do otherwise, which no file of this format holds.
    """
    parts = list(frames)
    even = even_motion(parts)
    if even is None or even.off > MOST_OFF:
        got = f"{even.off:.0%} that do otherwise" if even else "others from frame to frame"
        raise SceneError(f"{path}: expected Gaussians that move evenly, as FTGS has them, got {got}; .tsog holds all")
    m, degree = even.moving, even.moving.rest.sh_degree
    said = {"ftgs_version": 1, "time_units": "normalized", "sh_degree": degree, "use_velocity": 1}
    said |= {"min_duration": 1e-6, "opacity_floor": 0.0, "n_frames": len(parts)}
    names = [name for group in _FTGS for name in group]
    names += [f"f_rest_{i}" for i in range(3 * SH_REST[degree])]
    table = np.concatenate(
        [
            *(m.rest.means, m.rest.quaternions, m.rest.log_scales, logits_of(m.alpha)[:, None], m.rest.sh_dc),
            *(m.centres[:, None], np.log(m.widths / np.sqrt(2))[:, None], m.motion[:, 0]),
            m.rest.sh_rest.transpose(0, 2, 1).reshape(len(m.rest), -1),
        ],
        axis=1,
    )
    with path.open("wb") as file:
        write_floats(file, names, iter([table]), len(m.rest), [f"{name} {value}" for name, value in said.items()])


FTGS = ClipFormat(
    name="FTGS .ply",
    key="ftgs.ply",
    suffixes=(".ply",),
    fits=is_ftgs,
    open=open_ftgs,
    write=write_ftgs,
    holds=Holds(rounding="motion to what is even, fading to a normal distribution in time, all else to its mean"),
)
