"""FTGS .ply, version 1: Gaussians that move evenly and fade, found in frames, written and read back. N Gaussians.

At the normalised time t of [0, 1] a mean is mean + velocity (t - centre) and alpha is alpha exp(-((t - centre) /
deviation)^2 / 2); frame i of F is at i / (F - 1) (FORMAT.md of OpsiClear-4DGS/ftgs-player).
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError
from airgs_codec.scene.formats.clips import Moving
from airgs_codec.scene.formats.ply import read_columns, read_header, write_floats
from airgs_codec.scene.gaussians import LEAST_SHARE, SH_C0, SH_REST, Gaussians, logits_of, mean_frame, sigmoid

MOST_OFF = 0.02  # share of rows, of frames that are said to move evenly
LONGEST = 16.0  # of deviations in time: alpha then stays within 1/512 over all of it
_DEVIATIONS = np.geomspace(0.02, LONGEST, 32)  # that are tried, then others around the best
_FINER = tuple(np.geomspace(1 / reach, reach, 9) for reach in (1.24, 1.06, 1.015))
_FURTHEST = 2.0  # that the middle of a row's time may be from when it is seen: places are as exact as it is near
_FAINTEST = 1 / 255  # alpha from which it counts where a row is
_COLUMNS = (
    ("x", "y", "z"), tuple(f"rot_{i}" for i in range(4)), tuple(f"scale_{i}" for i in range(3)), ("opacity",),
    tuple(f"f_dc_{i}" for i in range(3)), ("time",), ("log_duration",), tuple(f"velocity_{i}" for i in range(3)),
)  # fmt: skip


def write_ftgs(path: Path, frames: Sequence[Gaussians], _fps: float) -> None:
    """Write frames whose Gaussians move evenly and fade. Raises SceneError for frames that do otherwise."""
    found = even_motion(frames)
    if found is None or found[1] > MOST_OFF:
        raise SceneError(f"{path}: expected Gaussians that move evenly, as FTGS has them")
    m, degree = found[0], found[0].rest.sh_degree
    said = {"ftgs_version": 1, "time_units": "normalized", "sh_degree": degree, "use_velocity": 1}
    said |= {"min_duration": 1e-6, "opacity_floor": 0.0, "n_frames": len(frames)}
    names = [name for group in (*_COLUMNS, _rest_names(degree)) for name in group]
    logits, deviations = logits_of(m.alpha)[:, None], np.log(m.widths / np.sqrt(2))[:, None]
    rest = m.rest.sh_rest.transpose(0, 2, 1).reshape(len(m.rest), -1)
    still = (m.rest.means, m.rest.quaternions, m.rest.log_scales, logits, m.rest.sh_dc)
    table = np.concatenate([*still, m.centres[:, None], deviations, m.motion[:, 0], rest], axis=1)
    target = io.BytesIO()
    write_floats(target, names, [table.astype(np.float32)])
    comments = "".join(f"comment {name} {value}\n" for name, value in said.items()).encode()
    path.write_bytes(target.getvalue().replace(b"element", comments + b"element", 1))


def read_ftgs(path: Path, frame: int) -> Gaussians:
    """One frame of a file that `write_ftgs` wrote."""
    header = read_header(path)
    lines = path.read_bytes()[: header.size].decode().splitlines()
    said = dict(line.split()[1:] for line in lines if line.startswith("comment"))
    rest = _rest_names(int(said["sh_degree"]))
    columns = read_columns(path, header, header.elements["vertex"], (*_COLUMNS, rest))
    means, quaternions, log_scales, logits, dc, centres, deviations, velocity, sh = columns
    harmonics = np.ascontiguousarray(sh.reshape(len(means), 3, len(rest) // 3).transpose(0, 2, 1))
    still = Gaussians(means, quaternions, log_scales, logits[:, 0], dc, harmonics)
    widths = np.exp(deviations[:, 0]) * np.float32(np.sqrt(2))
    moving = Moving(still, velocity[:, None], sigmoid(logits[:, 0]), centres[:, 0], widths)
    return moving.at(frame / max(1, int(said["n_frames"]) - 1))


def _rest_names(degree: int) -> tuple[str, ...]:
    return tuple(f"f_rest_{i}" for i in range(3 * SH_REST[degree]))


def even_motion(frames: Sequence[Gaussians]) -> tuple[Moving, float] | None:
    """The even motion that is nearest to frames, and the share of their rows that are off it; None: of other rows.

    It is found by least squares in which a row counts as it is seen.
    A row of a frame is off if it is half its size beside its place, its alpha, its colour or the logarithm of a size is
    0.05, 0.05 or 0.2 another, or it is turned by 0.2 radians.
    """
    if len({(len(g), g.sh_degree) for g in frames}) > 1:
        return None
    times = np.linspace(0, 1, len(frames)) if len(frames) > 1 else np.zeros(1)
    alphas = np.stack([g.opacities() for g in frames]).astype(np.float64)
    places = np.stack([g.means for g in frames])
    weights = np.square(alphas) + LEAST_SHARE  # so that what is never seen has a place
    weights /= weights.sum(axis=0)
    middle = np.einsum("fn,f->n", weights, times)
    late = times[:, None] - middle
    variance = np.einsum("fn,fn,fn->n", weights, late, late)
    moves = np.einsum("fn,fn,fnc->nc", weights, late, places)
    speed = np.divide(moves, variance[:, None], out=np.zeros_like(moves), where=variance[:, None] > 0)
    alpha, centres, deviations = _fading(alphas, weights, late)
    means = np.einsum("fn,fnc->nc", weights, places) + speed * centres[:, None]
    rest = replace(mean_frame(frames), means=means.astype(np.float32))
    motion, widths = speed.astype(np.float32)[:, None], (deviations * np.sqrt(2)).astype(np.float32)
    moving = Moving(rest, motion, alpha.astype(np.float32), (centres + middle).astype(np.float32), widths)
    off = [_is_off(moving.at(t), g).mean() for t, g in zip(times, frames, strict=True)]
    return moving, float(np.mean(off))


def _fading(
    alphas: NDArray[np.float64], weights: NDArray[np.float64], late: NDArray[np.float64]
) -> tuple[NDArray[np.float64], ...]:
    """(N,) largest alpha, its time and the deviation that are nearest to alphas (F, N); times are as in `late`."""
    logs = np.log(np.maximum(alphas, np.finfo(np.float32).tiny), dtype=np.float64)
    variance = np.einsum("fn,fn,fn->n", weights, late, late)
    least, best = np.full(alphas.shape[1], np.inf), np.ones((3, alphas.shape[1]))
    for factors in (_DEVIATIONS, *_FINER):
        for deviation in factors[:, None] * best[2]:
            curve = np.square(late / deviation) / 2
            level = np.einsum("fn,fn->n", weights, logs + curve)
            slope = np.einsum("fn,fn,fn->n", weights, late, logs + curve)
            slope = np.divide(slope, variance, out=np.zeros_like(slope), where=variance > 0)
            centre = np.clip(slope * deviation**2, -_FURTHEST, _FURTHEST)
            peak = np.minimum(0, level + np.square(centre / deviation) / 2)
            error = np.square(np.exp(peak - np.square((late - centre) / deviation) / 2) - alphas).sum(axis=0)
            better = error <= least  # of those that are as good, the longest
            least[better] = error[better]
            best[:, better] = np.stack([np.exp(peak), centre, deviation])[:, better]
    return tuple(best)


def _is_off(shown: Gaussians, g: Gaussians) -> NDArray[np.bool_]:
    """(N,) the rows of a frame that are somewhere else than they should be, as `even_motion` says."""
    alpha, wanted = shown.opacities(), g.opacities()
    size = np.exp(g.log_scales.mean(axis=1))
    turn = np.abs(np.einsum("nc,nc->n", shown.quaternions, g.quaternions))
    turn /= np.linalg.norm(shown.quaternions, axis=1) * np.linalg.norm(g.quaternions, axis=1)
    beside = np.linalg.norm(shown.means - g.means, axis=1) > size / 2
    beside |= np.abs(shown.log_scales - g.log_scales).max(axis=1) > 0.2
    beside |= np.abs(shown.sh_dc - g.sh_dc).max(axis=1) * SH_C0 > 0.05
    beside |= turn < np.cos(0.1)  # of half the angle
    return (beside & (np.maximum(alpha, wanted) > _FAINTEST)) | (np.abs(alpha - wanted) > 0.05)
