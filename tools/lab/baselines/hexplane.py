"""The deformation field of 4D Gaussian Splatting (Wu et al. 2024, section 4.2): a HexPlane and heads of a small MLP.

N Gaussians, T moments, R cells along an axis of space, F features, L resolutions.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import reduce
from itertools import combinations

import torch

from airgs_codec.trainer.fit.parameters import Parameters

AXES = 4  # x, y, z, t
PAIRS = tuple(combinations(range(AXES), 2))  # xy, xz, xt, yz, yt, zt
TIME = AXES - 1
HEADS = {"means": 3, "log_scales": 3, "quaternions": 4}  # what deforms; opacity and colour do not, as in the paper


@dataclass(frozen=True, slots=True)
class FieldSize:
    cells: int = 64  # R of the coarsest resolution
    moments: int = 12  # T, of all resolutions
    features: int = 16  # F of a plane
    resolutions: tuple[int, ...] = (1, 2)  # times R
    width: int = 64  # of a hidden layer


class Field(torch.nn.Module):
    """How Gaussians deform at a time: six planes at each resolution, a linear layer, a head for each attribute."""

    low: torch.Tensor
    high: torch.Tensor

    def __init__(self, size: FieldSize, low: torch.Tensor, high: torch.Tensor, seed: int) -> None:
        """`low`, `high`: (3,) corners of the box that the planes span, world units. `seed`: of the first numbers."""
        super().__init__()
        draw = torch.Generator().manual_seed(seed)
        self.register_buffer("low", low)
        self.register_buffer("high", high)
        self.planes = torch.nn.ParameterList(
            [_plane(pair, size, r, draw) for r in size.resolutions for pair in PAIRS]  # (1, F, rows, columns)
        )
        self.first = _linear(size.features * len(size.resolutions), size.width, draw)
        self.heads = torch.nn.ModuleDict({name: _head(size.width, out, draw) for name, out in HEADS.items()})

    def forward(self, p: Mapping[str, torch.Tensor], time: float) -> Parameters:
        """The Gaussians as they are at `time`, which is 0 at the first frame and 1 at the last."""
        hidden = self.first(self.encode(p["means"], time))
        return {name: value + self.heads[name](hidden) if name in HEADS else value for name, value in p.items()}

    def encode(self, means: torch.Tensor, time: float) -> torch.Tensor:
        """(N, F L) features: the product of the six planes at the means (N, 3) and the time, for each resolution.

        Beyond the box a plane has the values of its border.
        """
        place = 2 * (means - self.low) / (self.high - self.low) - 1
        axes = [*place.unbind(1), torch.full_like(place[:, 0], 2 * time - 1)]
        found = []
        for k in range(0, len(self.planes), len(PAIRS)):
            planes = zip(PAIRS, self.planes[k : k + len(PAIRS)], strict=True)
            found.append(reduce(torch.mul, [_sample(plane, axes[a], axes[b]) for (a, b), plane in planes]))
        return torch.cat(found, dim=0).t()


@dataclass(frozen=True, slots=True)
class PlaneWeights:
    """Weights of what planes add to the loss: the defaults of the authors' program."""

    space: float = 1e-4  # of the smoothness of planes of space
    time: float = 0.01  # of the smoothness of planes of time, along time
    still: float = 1e-4  # of the mean distance of planes of time from 1, at which nothing moves


def plane_loss(field: Field, weights: PlaneWeights) -> torch.Tensor:
    """Total variation of the planes (Wu et al. 2024, equation 7), of second differences, and what holds time at 1."""
    total = torch.zeros(())
    for k, plane in enumerate(field.planes):
        if TIME in PAIRS[k % len(PAIRS)]:
            total = total + weights.time * _roughness(plane) + weights.still * (1 - plane).abs().mean()
        else:
            total = total + weights.space * _roughness(plane)
    return total


def _roughness(plane: torch.Tensor) -> torch.Tensor:
    """Mean square of the second difference between rows, which of planes of time are moments."""
    if plane.shape[2] < 3:
        return torch.zeros(())  # the mean of no differences would be 0 / 0
    step = plane[..., 1:, :] - plane[..., :-1, :]
    return (step[..., 1:, :] - step[..., :-1, :]).square().mean()


def _plane(pair: tuple[int, int], size: FieldSize, times: int, draw: torch.Generator) -> torch.nn.Parameter:
    """Columns are the first axis of the pair and rows the second; planes of time start at 1."""
    rows = size.moments if TIME in pair else size.cells * times
    shape = (1, size.features, rows, size.cells * times)
    return torch.nn.Parameter(torch.ones(shape) if TIME in pair else 0.1 + 0.4 * torch.rand(shape, generator=draw))


def _sample(plane: torch.Tensor, column: torch.Tensor, row: torch.Tensor) -> torch.Tensor:
    """(F, N) bilinear samples at places of -1..1, (N,) each."""
    grid = torch.stack([column, row], dim=1)[None, None]
    return torch.nn.functional.grid_sample(plane, grid, padding_mode="border", align_corners=True)[0, :, 0]


def _linear(inputs: int, outputs: int, draw: torch.Generator) -> torch.nn.Linear:
    layer = torch.nn.Linear(inputs, outputs)
    torch.nn.init.xavier_uniform_(layer.weight, generator=draw)
    torch.nn.init.zeros_(layer.bias)
    return layer


def _head(width: int, outputs: int, draw: torch.Generator) -> torch.nn.Sequential:
    """Its last layer starts at 0: without training nothing deforms."""
    hidden, last = _linear(width, width, draw), _linear(width, outputs, draw)
    torch.nn.init.zeros_(last.weight)
    return torch.nn.Sequential(torch.nn.ReLU(), hidden, torch.nn.ReLU(), last)
