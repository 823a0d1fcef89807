"""Variables of a fit that moves Gaussians by six MLPs, one for each attribute (AirGS, "Training" 2).

N Gaussians, A MLPs, F features.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import torch

from airgs_codec.render.absgrad import AbsGrad
from airgs_codec.train.fit.adam import BETAS
from airgs_codec.train.fit.parameters import ATTRIBUTES, Parameters

OCTAVES = 5  # of the positional encoding (NeRF, Mildenhall et al. 2020, equation 4)
WIDTH = 64  # of a hidden layer
RATE, RATE_LAST = 1e-2, 0.1  # learning rate, and the share of it that is left at the end
# An output of 1 means this change, about the size of one in a frame; means in units of the scene's extent.
SCALES = {
    "means": 0.006,
    "quaternions": 0.05,
    "log_scales": 0.05,
    "opacity_logits": 0.2,
    "sh_dc": 0.05,
    "sh_rest": 0.02,
}


class Networks(torch.nn.Module):
    """One MLP for each attribute that has channels, with two hidden layers, evaluated side by side.

    Output layers start at zero: without training no Gaussian moves.
    """

    centre: torch.Tensor
    spread: torch.Tensor

    def __init__(self, like: Parameters, extent: float, seed: int) -> None:
        """Networks for Gaussians like these, whose statistics standardise the input.

        `extent`: of the scene in world units. `seed`: of the first weights.
        """
        super().__init__()
        self.names = [name for name in ATTRIBUTES if like[name][0].numel()]
        self.extent = extent
        features = self._encode(like)
        inputs, count = features.shape[1], len(self.names)
        draw = torch.Generator().manual_seed(seed)

        def layer(rows: int) -> torch.nn.Parameter:
            return torch.nn.Parameter(torch.randn(count, rows, WIDTH, generator=draw) * math.sqrt(2 / rows))

        self.register_buffer("centre", features.mean(dim=0))
        self.register_buffer("spread", features.std(dim=0) + 1e-4)  # a constant feature: 0, not 0 / 0
        self.first, self.second = layer(inputs), layer(WIDTH)
        self.first_bias = torch.nn.Parameter(torch.zeros(count, 1, WIDTH))
        self.second_bias = torch.nn.Parameter(torch.zeros(count, 1, WIDTH))
        self.last = torch.nn.ParameterList(
            [torch.nn.Parameter(torch.zeros(WIDTH, like[name][0].numel())) for name in self.names]
        )

    def features(self, p: Mapping[str, torch.Tensor]) -> torch.Tensor:
        """The standardised input (N, F)."""
        return (self._encode(p) - self.centre) / self.spread

    def forward(self, features: torch.Tensor) -> dict[str, torch.Tensor]:
        """Changes (N, channels) of each attribute from features (N, F)."""
        hidden = torch.relu(torch.matmul(features[None], self.first) + self.first_bias)
        hidden = torch.relu(torch.bmm(hidden, self.second) + self.second_bias)
        scales = SCALES | {"means": SCALES["means"] * self.extent}
        return {n: (hidden[i] @ self.last[i]) * scales[n] for i, n in enumerate(self.names)}

    def _encode(self, p: Mapping[str, torch.Tensor]) -> torch.Tensor:
        x = p["means"] / self.extent
        waves = [wave(x * 2**k * math.pi) for k in range(OCTAVES) for wave in (torch.sin, torch.cos)]
        rest = [p[name].reshape(len(x), -1) for name in self.names if name != "means"]
        return torch.cat([x, *waves, *rest], dim=1)

    def arrays(self) -> dict[str, np.ndarray]:
        """Copies of all numbers by name, for a file."""
        return {name: value.cpu().numpy().copy() for name, value in self.state_dict().items()}

    def load(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Take the numbers that `arrays` of networks of the same sizes gave."""
        self.load_state_dict({name: torch.from_numpy(np.array(value)) for name, value in arrays.items()})


@dataclass(slots=True, eq=False)
class MlpDriven:
    """Base Gaussians that move as the networks say. The networks' weights go on from frame to frame."""

    base: Parameters
    networks: Networks
    temporal: Parameters | None  # weight of |change| of each element, `temporal_weights`
    _features: torch.Tensor = field(init=False)
    _changes: Parameters = field(init=False)  # of the last `current`
    _adam: torch.optim.Adam = field(init=False)

    def __post_init__(self) -> None:
        self._features = self.networks.features(self.base)
        self._changes = {}
        self._adam = torch.optim.Adam(self.networks.parameters(), lr=RATE, betas=BETAS)

    def current(self) -> Parameters:
        """GS_t + d_{t+1}, differentiable by the weights."""
        self._changes = {n: d.reshape(self.base[n].shape) for n, d in self.networks(self._features).items()}
        return {n: p + self._changes[n] if n in self._changes else p for n, p in self.base.items()}

    def detached(self) -> Parameters:
        """The Gaussians as they are now."""
        with torch.no_grad():
            return self.current()

    def watch(self) -> AbsGrad | None:
        """None: rows are not added."""
        return None

    def penalty(self) -> torch.Tensor | float:
        """L_temp of the changes that `current` gave last."""
        if self.temporal is None:
            return 0.0
        return sum((self.temporal[name] * d.abs()).sum() for name, d in self._changes.items())

    def step(self, iteration: int, iterations: int) -> None:
        """Move the weights along the gradients, by Adam."""
        for group in self._adam.param_groups:
            group["lr"] = RATE * RATE_LAST ** (iteration / iterations)
        self._adam.step()
        self._adam.zero_grad(set_to_none=True)
