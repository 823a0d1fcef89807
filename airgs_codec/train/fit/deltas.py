"""Six MLPs that say how each Gaussian changes from one frame to the next (AirGS, "Training" 2). N Gaussians, A MLPs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import torch

from airgs_codec.train.fit.parameters import ATTRIBUTES, BETAS, Parameters

OCTAVES = 5  # of the positional encoding
WIDTH = 64
RATE, RATE_LAST = 1e-2, 0.1
# What an output of 1 means: about the size of a change; means in units of the scene's extent.
SCALES = {
    "means": 0.006,
    "quaternions": 0.05,
    "log_scales": 0.05,
    "opacity_logits": 0.2,
    "sh_dc": 0.05,
    "sh_rest": 0.02,
}


class Networks(torch.nn.Module):
    """One MLP an attribute, two hidden layers each, evaluated side by side; attributes without channels have none.

    Output layers start at zero: no Gaussian moves before it is told to.
    """

    centre: torch.Tensor
    spread: torch.Tensor

    def __init__(self, like: Parameters, extent: float, seed: int) -> None:
        """Sizes from the parameters `like`, whose statistics standardise the input."""
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
        """(N, F) standardised input."""
        return (self._encode(p) - self.centre) / self.spread

    def forward(self, features: torch.Tensor) -> dict[str, torch.Tensor]:
        """(N, F) -> changes, (N, channels) each."""
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
        """All numbers, by name, to be kept."""
        return {name: value.cpu().numpy() for name, value in self.state_dict().items()}

    def load(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Inverse of `arrays`, for networks of the same sizes."""
        self.load_state_dict({name: torch.from_numpy(np.array(value)) for name, value in arrays.items()})


@dataclass(slots=True, eq=False)
class Driven:
    """Variables of `fit.match`: every Gaussian moves as the networks say; their weights go on from frame to frame."""

    base: Parameters
    networks: Networks
    weights: Parameters | None  # of |d| an element: `Temporal.weights`
    _features: torch.Tensor = field(init=False)
    _changes: Parameters = field(init=False)
    _adam: torch.optim.Adam = field(init=False)

    def __post_init__(self) -> None:
        self._features = self.networks.features(self.base)
        self._adam = torch.optim.Adam(self.networks.parameters(), lr=RATE, betas=BETAS)

    def current(self) -> Parameters:
        """GS_t + d_{t+1}."""
        self._changes = {n: d.reshape(self.base[n].shape) for n, d in self.networks(self._features).items()}
        return {n: self.base[n] + self._changes[n] if n in self._changes else self.base[n] for n in ATTRIBUTES}

    def penalty(self) -> torch.Tensor | float:
        """L_temp of the last changes."""
        if self.weights is None:
            return 0.0
        return sum((self.weights[name] * d.abs()).sum() for name, d in self._changes.items())

    def step(self, done: float) -> None:
        """Adam on the networks' weights."""
        for group in self._adam.param_groups:
            group["lr"] = RATE * RATE_LAST**done
        self._adam.step()
        self._adam.zero_grad(set_to_none=True)

    def detached(self) -> Parameters:
        """The Gaussians as they are now."""
        with torch.no_grad():
            return self.current()
