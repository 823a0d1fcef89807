"""The renderer's definition, slow and plain: every pixel against every Gaussian, float64, torch for its gradients.

P pixels, N Gaussians. EWA splatting as in 3D Gaussian Splatting (Kerbl et al. 2023), with gsplat's constants.
"""

from __future__ import annotations

import torch

from airgs_codec.render.cpu import DILATION, FAR_PLANE, RasterInputs
from airgs_codec.render.cpu_kernels import LINEAR_MARGIN
from airgs_codec.scene.camera import Background, Camera
from airgs_codec.scene.gaussians import SH_C0

Picture = tuple[torch.Tensor, torch.Tensor]  # rgb (H, W, 3), transmittance (H, W)


def rotation_matrices(q: torch.Tensor) -> torch.Tensor:
    """Return rotation matrices (N, 3, 3) of quaternions (N, 4) of any length; zero gives identity."""
    norm = q.norm(dim=-1, keepdim=True)
    identity = torch.tensor([1.0, 0, 0, 0], dtype=q.dtype)
    unit = torch.where(norm > 1e-12, q / torch.where(norm > 1e-12, norm, torch.ones_like(norm)), identity)
    w, x, y, z = unit.unbind(-1)
    rows = [
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    ]
    return torch.stack(rows, -1).reshape(-1, 3, 3)


def sh_values(directions: torch.Tensor, sh: torch.Tensor) -> torch.Tensor:
    """Return values (N, 3) of coefficients (N, K + 1, 3) in unit directions (N, 3); colours are 0.5 more."""
    x, y, z = directions.unbind(-1)
    xx, yy, zz = x * x, y * y, z * z
    c1, c2, c3 = 0.4886025119029199, 1.0925484305920792, 0.5900435899266435
    basis = [
        *(torch.full_like(x, SH_C0), -c1 * y, c1 * z, -c1 * x),
        *(c2 * x * y, -c2 * y * z, 0.31539156525252005 * (2 * zz - xx - yy), -c2 * x * z, c2 / 2 * (xx - yy)),
        *(-c3 * y * (3 * xx - yy), 2.890611442640554 * x * y * z, -0.4570457994644658 * y * (4 * zz - xx - yy)),
        0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy),
        *(-0.4570457994644658 * x * (4 * zz - xx - yy), 1.445305721320277 * z * (xx - yy)),
        -c3 * x * (xx - 3 * yy),
    ]
    return (torch.stack(basis[: sh.shape[-2]], -1)[..., None] * sh).sum(-2)


def render_reference(
    inputs: RasterInputs[torch.Tensor], camera: Camera, background: Background | None = None
) -> Picture:
    """Draw rgb (H, W, 3) and transmittance (H, W) in the precision of the inputs."""
    weights, transmittance, colours = blending_weights(inputs, camera)
    rgb = weights @ colours + transmittance[:, None] * torch.tensor(
        camera.background if background is None else background, dtype=colours.dtype
    )
    return rgb.reshape(camera.height, camera.width, 3), transmittance.reshape(camera.height, camera.width)


def blending_weights(
    inputs: RasterInputs[torch.Tensor], camera: Camera
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return alpha T of every pixel and Gaussian (P, N), final transmittance (P,), colours (N, 3)."""
    means, opacities = inputs.means, inputs.opacities
    view = torch.as_tensor(camera.world_to_camera, dtype=means.dtype)
    rotation, translation = view[:3, :3], view[:3, 3]
    x, y, z = (means @ rotation.T + translation).unbind(-1)
    drawn = (z > camera.near) & (z < FAR_PLANE) & (opacities * 255 > 1)
    z = torch.where(drawn, z, torch.ones_like(z))
    conic, position = _conics(inputs, torch.stack([x, y, z], -1), camera)
    directions = torch.nn.functional.normalize(means + rotation.T @ translation, dim=-1)
    colours = (sh_values(directions, inputs.sh) + 0.5).clamp_min(0)
    order = torch.argsort(torch.where(drawn, z, torch.full_like(z, torch.inf)), stable=True)
    rows, columns = torch.meshgrid(torch.arange(camera.height), torch.arange(camera.width), indexing="ij")
    pixels = torch.stack([columns.reshape(-1), rows.reshape(-1)], -1).to(means.dtype) + 0.5
    d = pixels[:, None] - position[None]
    power = -0.5 * torch.einsum("pni,nij,pnj->pn", d, conic, d)
    alpha = opacities * torch.exp(power)
    alpha = torch.where((alpha >= 1 / 255) & drawn, alpha.clamp_max(0.999), torch.zeros_like(alpha))[:, order]
    after = torch.cumprod(1 - alpha, -1)
    alpha = torch.where(after > 1e-4, alpha, torch.zeros_like(alpha))  # falls steadily: all that follow stop too
    before = torch.cat([torch.ones_like(after[:, :1]), torch.cumprod(1 - alpha, -1)], -1)
    weights = torch.zeros_like(alpha).index_copy(1, order, alpha * before[:, :-1])
    return weights, before[:, -1], colours


def _conics(
    inputs: RasterInputs[torch.Tensor], places: torch.Tensor, camera: Camera
) -> tuple[torch.Tensor, torch.Tensor]:
    """Inverse projected covariances (N, 2, 2) and pixel positions (N, 2) of `places` (N, 3) in camera space."""
    rotation = torch.as_tensor(camera.world_to_camera[:3, :3], dtype=places.dtype)
    x, y, z = places.unbind(-1)
    u, v = x / z, y / z
    margin_x, margin_y = LINEAR_MARGIN * camera.width / camera.fx, LINEAR_MARGIN * camera.height / camera.fy
    uc = u.clamp(-camera.cx / camera.fx - margin_x, (camera.width - camera.cx) / camera.fx + margin_x)
    vc = v.clamp(-camera.cy / camera.fy - margin_y, (camera.height - camera.cy) / camera.fy + margin_y)
    zero = torch.zeros_like(z)
    jacobian = [camera.fx / z, zero, -camera.fx * uc / z, zero, camera.fy / z, -camera.fy * vc / z]
    shape = rotation_matrices(inputs.quaternions) * inputs.scales[:, None]
    half = torch.stack(jacobian, -1).reshape(-1, 2, 3) @ rotation @ shape
    covariance = half @ half.transpose(1, 2) + DILATION * torch.eye(2, dtype=x.dtype)
    a, b, c = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    minors = torch.linalg.cross(half[:, 0], half[:, 1])  # Cauchy-Binet: no cancellation for needles
    det = (minors * minors).sum(-1) + DILATION * (a + c - 2 * DILATION) + DILATION**2
    conic = torch.stack([c, -b, -b, a], -1).reshape(-1, 2, 2) / det[:, None, None]
    return conic, torch.stack([camera.fx * u + camera.cx, camera.fy * v + camera.cy], -1)
