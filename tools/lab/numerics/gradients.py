"""Gradients of the CPU kernels, which sum in float32, against the renderer's definition in float64."""

from __future__ import annotations

from functools import cache, partial

import numpy as np
import torch
from numpy.typing import NDArray

from airgs_codec.render import Camera, cpu
from airgs_codec.render.cpu import RasterInputs
from airgs_codec.render.reference import render_reference
from airgs_codec.scene.frames import QUATERNION_MIN_NORM
from airgs_codec.scene.gaussians import Gaussians
from tools.lab.numerics.outcome import BOUNDED, Case, Judged, error_end, grid
from tools.lab.numerics.problems import AXES, Axis

CLOSE = 1e-3  # relative: the bound of docs/numerics.md for needles and tiny quaternions
SEEDS = 3  # of the pictures' derivatives; the median over them and the cameras counts
TARGETS = ("motion", "changes")  # axes that change the target of a fit, not where its gradients begin
NAMES = ("means", "quaternions", "scales", "opacities", "sh")
ROUND = 1e-3  # of the gradient by log-scales: what a rotation of a round Gaussian would need to change anything


def gradients(g: Gaussians, camera: Camera, pull: NDArray[np.float32]) -> list[NDArray[np.float64]]:
    """dL / d of each of NAMES by the CPU kernels, for dL / d rgb (H, W, 3)."""
    inputs = cpu.activate(g)
    blended = cpu.blend(inputs, camera, camera.background)
    none = np.zeros(pull.shape[:2], np.float32)
    return [column.astype(np.float64) for column in cpu.gradients(blended, pull, none)[0]]


def exact_gradients(g: Gaussians, camera: Camera, pull: NDArray[np.float32]) -> list[NDArray[np.float64]]:
    """The same by automatic differentiation of the definition in float64, of the same float32 inputs."""
    leaves = [torch.from_numpy(column.astype(np.float64)).requires_grad_(True) for column in cpu.activate(g)]
    rgb, _ = render_reference(RasterInputs(*leaves), camera)
    (rgb * torch.from_numpy(pull.astype(np.float64))).sum().backward()
    return [np.zeros(leaf.shape) if leaf.grad is None else leaf.grad.numpy() for leaf in leaves]


def relative_errors(g: Gaussians, camera: Camera, pull: NDArray[np.float32]) -> list[float]:
    """|kernels - definition| / |definition| of each of NAMES; 0 where both are 0.

    To turn a round Gaussian changes nothing, so that its gradient is rounding noise: errors of quaternions are
    relative to ROUND of the gradient by log-scales, over the length of the quaternions, where that is more.
    """
    ours, exact = gradients(g, camera, pull), exact_gradients(g, camera, pull)
    sizes = [float(np.linalg.norm(part)) for part in exact]
    length = float(np.linalg.norm(g.quaternions.astype(np.float64), axis=1).min())
    if length > QUATERNION_MIN_NORM:
        by_log_scales = np.linalg.norm(exact[2] * np.exp(g.log_scales.astype(np.float64)))
        sizes[1] = max(sizes[1], ROUND * float(by_log_scales) / length)
    errors = [float(np.linalg.norm(a - b)) for a, b in zip(ours, exact, strict=True)]
    return [0.0 if error == 0 else error / size if size else np.inf for error, size in zip(errors, sizes, strict=True)]


@cache
def median_errors(axis: Axis, value: float) -> dict[str, float]:
    """The relative error of each of NAMES at a value of an axis: the median over SEEDS and cameras."""
    problem = axis.make(value)
    errors = []
    for seed in range(SEEDS):
        rng = np.random.default_rng(seed)
        for camera in problem.cameras:
            pull = rng.normal(size=(camera.height, camera.width, 3)).astype(np.float32)
            errors.append(relative_errors(problem.start, camera, pull))
    return dict(zip(NAMES, np.median(np.array(errors), axis=0).tolist(), strict=True))


def judge(axis: Axis, panel: str, name: str, value: float) -> Judged:
    error = median_errors(axis, value)[name]
    end = error_end(error, CLOSE)
    return end, error, f"relative error up to {error:.2g}" if end == BOUNDED else ""


def cases() -> list[Case]:
    return [
        Case(
            part="gradients", name=f"gradients-{axis.name}",
            title=f"Gradients: {axis.title[0].lower()}{axis.title[1:]}",
            own=("kernels", ""), points=grid(["kernels"], NAMES, axis.values), judge=partial(judge, axis),
        )
        for axis in AXES
        if axis.name not in TARGETS
    ]  # fmt: skip
