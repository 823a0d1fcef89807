"""Gaussians as tensors, what is drawn of them, and how far that is from pictures, with gradients.

L_3DGS = (1 - lambda) L1 + lambda (1 - SSIM) (AirGS, "Representation"): on the CPU one fused pass (`kernels`), on CUDA
the same numbers from separable convolutions.

The paper's L_temp, a norm of d, has no unit and no reduction (AirGS, "Training" 2): with its 1e-3 a sum over plain
values stops all motion, means do little. Here it is weight * mean_i sum_c |d_ic| / step_ic, a mean over Gaussians in
units of the steps by which the codec will code each channel; plain sums and means may be had, too.

The PSNR of training is the mean over views of each view's PSNR in dB. The PSNR of a package pools the squared error of
its pictures first, and is lower where views differ.

N Gaussians, K SH coefficients past DC, V views, H x W pixels. Names are those of `Gaussians`: six attributes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from airgs_codec.analysis.sensitivity import measure_sensitivity
from airgs_codec.coding.motion import StepSettings, classify_motion, motion_units
from airgs_codec.media.image import to_bytes, to_floats
from airgs_codec.media.metrics import Picture, psnr
from airgs_codec.render import cuda
from airgs_codec.render.backend import CPU, Loaded, Renderer
from airgs_codec.render.compare import compare
from airgs_codec.render.cpu import POOLED, RasterInputs
from airgs_codec.render.cuda import AbsGrad, Pictures, rasterize, upload
from airgs_codec.scene.camera import Camera, scene_scale
from airgs_codec.scene.frames import QUATERNION_MIN_NORM
from airgs_codec.scene.gaussians import SH_REST, Gaussians
from airgs_codec.trainer.data.pictures import TargetPicture, View
from airgs_codec.trainer.fit import kernels
from airgs_codec.trainer.settings import Temporal

GAUSSIAN_FIELDS = tuple(f.name for f in fields(Gaussians))
Parameters = dict[str, torch.Tensor]  # attribute -> (N, ...)
# Quaternions of other lengths are made unit ones before a fit: Adam's steps have one size, by which a short quaternion
# would be thrown about and a long one could not turn.
LENGTHS = (0.1, 10.0)


@dataclass(frozen=True, slots=True, eq=False)
class InMotion:
    gaussians: Gaussians
    velocity: NDArray[np.float32] | None = None  # (N, 3) what means move by in a frame; None: not known
    cleared: int = 0  # rows of its fit that hung in open space and were removed

    def at(self, after: float) -> Gaussians:
        """Return them `after` frames past their time; as they are without a velocity."""
        if not after or self.velocity is None:
            return self.gaussians
        return replace(self.gaussians, means=self.gaussians.means + np.float32(after) * self.velocity)


def loading(g: Gaussians | InMotion, renderer: Renderer) -> Callable[[float], Loaded]:
    """Return a function that loads Gaussians some frames after their time, each once."""
    return cache(lambda after: renderer.load(g.at(after) if isinstance(g, InMotion) else g))


def from_gaussians(g: Gaussians, device: str = "cpu") -> Parameters:
    """Copy to a device; quaternions of a length not within LENGTHS get length 1, but for those drawn as identity."""
    length = np.linalg.norm(g.quaternions.astype(np.float64), axis=1, keepdims=True)
    usual = ((length >= LENGTHS[0]) & (length <= LENGTHS[1])) | ~(length > QUATERNION_MIN_NORM)
    unit = np.where(usual, g.quaternions, g.quaternions / np.where(usual, 1.0, length)).astype(np.float32)
    columns = {name: getattr(g, name) for name in GAUSSIAN_FIELDS} | {"quaternions": unit}
    return {name: torch.tensor(column, device=device) for name, column in columns.items()}


def to_gaussians(p: Mapping[str, torch.Tensor]) -> Gaussians:
    return Gaussians(*(p[name].detach().cpu().numpy().astype(np.float32) for name in GAUSSIAN_FIELDS))


def multiply(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Return the Hamilton product of quaternions (N, 4)."""
    aw, av, bw, bv = a[:, :1], a[:, 1:], b[:, :1], b[:, 1:]
    vector = aw * bv + bw * av + torch.linalg.cross(av, bv)
    return torch.cat([aw * bw - (av * bv).sum(dim=1, keepdim=True), vector], dim=1)


def rotate(q: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
    """Turn vectors (N, 3) by unit quaternions (N, 4)."""
    turned = 2 * torch.linalg.cross(q[:, 1:], v)
    return v + q[:, :1] * turned + torch.linalg.cross(q[:, 1:], turned)


MOTION = "motion"  # a further parameter (N, 3): what means move by in a frame


def with_motion(p: Parameters, views: Sequence[View], motion: NDArray[np.float32] | None = None) -> Parameters:
    """Return parameters with a motion, by default 0, where views show them at other times."""
    if not any(view.after for view in views):
        return p
    start = torch.zeros_like(p["means"]) if motion is None else torch.from_numpy(motion).to(p["means"])
    return p | {MOTION: start}


def to_moving(p: Parameters) -> InMotion:
    """Return copies in float32, with the motion, if any."""
    motion = p.get(MOTION)
    return InMotion(to_gaussians(p), None if motion is None else motion.cpu().numpy().astype(np.float32))


def zeros_like(p: Mapping[str, torch.Tensor]) -> Parameters:
    return {name: torch.zeros_like(value) for name, value in p.items()}


def take_and_append(old: Parameters, keep: torch.Tensor, new: Parameters | None) -> Parameters:
    """Return the rows of `old` in the mask `keep` (N,), in order, and the rows of `new` after them."""
    return {n: v[keep] if new is None else torch.cat([v[keep], new[n]]) for n, v in old.items()}


def render(p: Parameters, camera: Camera, sh_degree: int, absgrad: AbsGrad | None = None) -> Pictures:
    """Draw the picture (H, W, 3) and its transmittance (H, W), differentiable, with SH up to `sh_degree`."""
    rgb, transmittance = render_views(p, [camera], sh_degree, absgrad)
    return rgb[0], transmittance[0]


def render_views(p: Parameters, cameras: Sequence[Camera], sh_degree: int, *more: Any) -> Pictures:
    """Draw the same for each of several cameras (C, H, W, ...); `more`: of `rasterize`."""
    sh = torch.cat([p["sh_dc"][:, None], p["sh_rest"][:, : SH_REST[sh_degree]]], dim=1)
    scales, opacities = p["log_scales"].exp(), p["opacity_logits"].sigmoid()
    return rasterize(RasterInputs(p["means"], p["quaternions"], scales, opacities, sh), cameras, *more)


POOLED.append(kernels)
LAMBDA = 0.2  # weight of 1 - SSIM, as AirGS and 3DGS have it


def photometric(rgb: torch.Tensor, targets: Sequence[Any], weight: float = LAMBDA) -> torch.Tensor:
    """Return L_3DGS (C,) of rendered pictures (C, H, W, 3); `weight` is lambda.

    `targets`: of their views, on CUDA of `uploaded` ones.
    """
    if cuda.by_gsplat(rgb):
        loss: torch.Tensor = _InPlanes.apply(rgb, as_floats(torch.stack(list(targets))), weight)
    else:
        loss = _InRows.apply(rgb, targets, weight)
    return loss


class _InRows(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, rgb: torch.Tensor, targets: Sequence[TargetPicture], weight: float) -> torch.Tensor:
        pictures = np.ascontiguousarray(rgb.detach().numpy(), np.float32)
        gradient, losses = np.empty_like(pictures), []
        for picture, target, into in zip(pictures, targets, gradient, strict=True):
            rows, sums = picture.reshape(target.rows.shape), np.empty((len(picture), 2))
            arguments = (1 - weight, weight, *_scratch(rows.shape), into.reshape(rows.shape), sums)
            kernels.l1_dssim(rows, target.rows, *moments(target), *arguments)
            l1, ssim = sums.sum(axis=0) / rows.size
            losses.append((1 - weight) * l1 + weight * (1 - ssim))
        ctx.gradient = torch.from_numpy(gradient)
        return torch.tensor(losses, dtype=torch.float32)

    @staticmethod
    def backward(ctx: Any, *grads: Any) -> tuple[Any, ...]:
        return ctx.gradient * grads[0][:, None, None, None], None, None


def moments(target: TargetPicture) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return windowed mean and variance of a target for SSIM, (H, n) each, which it stores."""
    if target.moments is None:
        target.moments = np.empty_like(target.rows), np.empty_like(target.rows)
        kernels.window_moments(target.rows, *target.moments)
    return target.moments


@cache
def _scratch(shape: tuple[int, ...]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    padded = (3, shape[0] + 2 * kernels.RADIUS, shape[1])
    return np.zeros(padded, np.float32), np.zeros(padded, np.float32)


class _InPlanes(torch.autograd.Function):
    """The same of all pictures at once, on any device, in as few operators as possible: a launch takes longer."""

    @staticmethod
    def forward(ctx: Any, rgb: torch.Tensor, y: torch.Tensor, weight: float) -> torch.Tensor:
        x = rgb.permute(0, 3, 1, 2).contiguous()
        mean_x, mean_y, square_x, square_y, product = _blur(x, y, x * x, y * y, x * y)
        means, squares = mean_x * mean_y, torch.addcmul(mean_x * mean_x, mean_y, mean_y)
        c1, c2 = float(kernels.C1), float(kernels.C2)
        a, b = means.mul(2).add_(c1), (product - means).mul_(2).add_(c2)
        c, d = squares + c1, (square_x + square_y).sub_(squares).add_(c2)
        # SSIM is a b / (c d). Half its derivatives by the windowed x, x^2 and x y; variances depend on the first, too.
        whole = c * d
        by_product = a / whole
        ssim = by_product * b
        by_square = ssim / d
        by_mean = (b / whole).sub_(by_product).mul_(mean_y).addcmul_(mean_x, by_square - ssim / c)
        by_mean, by_square, by_product = _blur(by_mean, by_square, by_product)
        gradient, size = by_mean.addcmul_(x, by_square, value=-1).addcmul_(y, by_product), x[0].numel()
        error = x - y
        ctx.gradient = gradient.mul_(-2 * weight / size).add_(error.sign(), alpha=(1 - weight) / size)
        l1, similarity = error.abs_().mean(dim=(1, 2, 3)), ssim.mean(dim=(1, 2, 3))
        return (l1 * (1 - weight)).sub_(similarity, alpha=weight).add_(weight)

    @staticmethod
    def backward(ctx: Any, *grads: Any) -> tuple[Any, ...]:
        return (ctx.gradient * grads[0].view(-1, 1, 1, 1)).permute(0, 2, 3, 1), None, None


def uploaded(views: Sequence[View], device: torch.device) -> list[View]:
    """Return views whose targets (3, H, W) are on a device: in bytes where those are exact for all, else in float32."""
    found = []
    for view in views:
        rgb = view.target.rgb
        levels = to_bytes(rgb)
        exact = levels if np.array_equal(to_floats(levels), rgb) else rgb
        found.append(replace(view, picture=upload(np.ascontiguousarray(np.moveaxis(exact, 2, 0)), device)))
    alike = len({view.target.dtype for view in found}) == 1
    return found if alike else [replace(view, picture=as_floats(view.target)) for view in found]


def as_floats(levels: torch.Tensor) -> torch.Tensor:
    return levels if levels.is_floating_point() else levels.float().div_(255)


@cache
def _windows(count: int, device: torch.device, dtype: torch.dtype) -> tuple[torch.Tensor, torch.Tensor]:
    half = [kernels.W0, kernels.W1, kernels.W2, kernels.W3, kernels.W4]
    window = torch.tensor([*half, kernels.W5, *half[::-1]]).to(device, dtype).repeat(count, 1, 1, 1)
    return window, window.transpose(2, 3).contiguous()


def _blur(*pictures: torch.Tensor) -> Sequence[torch.Tensor]:
    """Windowed pictures (C, 3, H, W) that are zero outside, in one convolution across and one down."""
    planes = torch.stack(pictures).flatten(0, 2)[None]
    across, down = _windows(planes.shape[1], planes.device, planes.dtype)
    planes = torch.nn.functional.conv2d(planes, across, padding=(0, kernels.RADIUS), groups=planes.shape[1])
    planes = torch.nn.functional.conv2d(planes, down, padding=(kernels.RADIUS, 0), groups=planes.shape[1])
    return planes.view(len(pictures), *pictures[0].shape).unbind()


def temporal_weights(temporal: Temporal, steps: Mapping[str, torch.Tensor]) -> Parameters:
    """Return the weight of |d| of every element, from the codec step of each."""
    if temporal.unit == "step":
        return {name: temporal.weight / (len(step) * step) for name, step in steps.items()}
    over: Callable[[torch.Tensor], int] = {"sum": lambda _: 1, "gaussians": len, "elements": torch.numel}[temporal.unit]
    return {name: torch.full_like(step, temporal.weight / max(1, over(step))) for name, step in steps.items()}


def codec_steps(g: Gaussians, cameras: Sequence[Camera], renderer: Renderer = CPU) -> Parameters:
    """Return a codec step for every element of the stored attributes, to first order, where the Gaussians are now.

    Means: the row's motion unit, by how much pictures depend on it. Quaternions: half the rotation's step, as a small
    rotation w changes a unit quaternion by w / 2. Opacity: the step of alpha over alpha's derivative by the logit,
    which is at least 0.02: near 0 and 1 a step of alpha is no finite logit.
    """
    delta, alpha = StepSettings().delta, g.opacities()
    scale = scene_scale(cameras, g.means, alpha)
    sensitivity = measure_sensitivity([g], cameras, renderer)
    means = scale * motion_units(classify_motion(sensitivity.means, g, scale)) * delta.means
    length = np.linalg.norm(g.quaternions.astype(np.float64), axis=1, keepdims=True)
    quaternions = delta.quaternions / 2 * np.maximum(length, 1e-12)
    opacity = delta.opacity / np.maximum(alpha * (1 - alpha), 0.02)
    columns = means[:, None], quaternions, delta.log_scales, opacity, delta.sh_dc, delta.sh_rest
    shaped = {n: np.broadcast_to(c, getattr(g, n).shape) for n, c in zip(GAUSSIAN_FIELDS, columns, strict=True)}
    return {name: torch.from_numpy(column.astype(np.float32)) for name, column in shaped.items()}


PSNR_DEFINITION = "mean over views of the PSNR of each, in dB"


def mean_psnr(g: Gaussians | InMotion, views: Sequence[View], renderer: Renderer = CPU) -> float:
    """Return the mean over views of each view's PSNR in dB."""
    return float(np.mean([psnr(error) for error in _compare(g, views, renderer, Picture.mse)]))


def matched_psnr(g: Gaussians | InMotion, views: Sequence[View], renderer: Renderer = CPU) -> float:
    """Return the mean PSNR over views in dB, with the best gain and offset of each channel if halves agree."""
    return float(np.mean([psnr(error) for error in _compare(g, views, renderer, _matched_mse)]))


def _matched_mse(picture: Picture, shown: Picture) -> float:
    whole, middle, plain = np.stack([picture.rgb, shown.rgb]), picture.rgb.shape[1] // 2, picture.mse(shown)
    left, right = whole[:, :, :middle], whole[:, :, middle:]
    crossed = (_mse_after(left, right) * left.size + _mse_after(right, left) * right.size) / whole.size
    return min(plain, _mse_after(whole, whole)) if crossed < plain else plain


def _mse_after(found_in: NDArray[np.float32], used_in: NDArray[np.float32]) -> float:
    """Return mean squared error of a target and what is drawn, (2, H, W, 3), after gains and offsets of other ones."""
    errors, channels = [], (np.moveaxis(p, 3, 0).reshape(3, 2, -1) for p in (found_in, used_in))
    for (a, b), (target, drawn) in zip(*channels, strict=True):
        known = [np.stack([shown, np.ones_like(shown)], axis=1).astype(np.float64) for shown in (b, drawn)]
        matched = known[1] @ np.linalg.lstsq(known[0], a.astype(np.float64), rcond=None)[0]
        errors.append(np.square(np.clip(matched, 0, 1) - target).mean())
    return float(np.mean(errors))


def better(before: Gaussians, after: Gaussians, views: Sequence[View], renderer: Renderer = CPU) -> Gaussians:
    """Return the one that shows more, `after` if equal, which is what `before` has moved to in a frame."""
    moving = InMotion(after, after.means - before.means)
    return before if mean_psnr(before, views, renderer) > mean_psnr(moving, views, renderer) else after


def mean_ssim(g: Gaussians | InMotion, views: Sequence[View], renderer: Renderer = CPU) -> float:
    """Return the mean over views of each view's SSIM, 1 for equal pictures."""
    return float(np.mean(list(_compare(g, views, renderer, Picture.ssim))))


def _compare(
    g: Gaussians | InMotion, views: Sequence[View], renderer: Renderer, measure: Callable[[Picture, Picture], float]
) -> Iterator[float]:
    """Compare each view's picture as it was taken with what is drawn."""
    loaded, numbered = loading(g, renderer), [(i, view.camera) for i, view in enumerate(views)]

    def shown(i: int, camera: Camera) -> Picture:
        return Picture.of(loaded(views[i].after).draw(camera).rgb)

    return compare(lambda i, _: Picture.of(views[i].target.rgb), shown, numbered, measure)
