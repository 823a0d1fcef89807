"""Adam for Gaussians: rows may come and go, and an L1 norm is applied by its proximal map. N Gaussians."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch

from airgs_codec.train.fit.parameters import Parameters, take_and_append, zeros_like

BETAS = (0.9, 0.999)
# Adam divides by the size of the gradient: without a floor it would move attributes that pictures do not depend on
# (the rotation of a ball) as far as others, by rounding noise. Gradients of pictures are 1e-8 and more.
EPSILON = 1e-12


@dataclass(slots=True, eq=False)
class _Moments:
    first: Parameters
    second: Parameters


class Adam:
    """Adam (Kingma and Ba 2015) over named tensors whose rows may come and go."""

    def __init__(
        self, parameters: Mapping[str, torch.Tensor], rates: Mapping[str, float], epsilon: float = EPSILON
    ) -> None:
        """`parameters` are copied and made leaves; `rates` may be changed between steps through `self.rates`."""
        self._epsilon = epsilon
        self.parameters = _leaves({name: p.detach().clone() for name, p in parameters.items()})
        self.rates = dict(rates)
        self._moments = _Moments(zeros_like(parameters), zeros_like(parameters))
        self._steps = 0

    @torch.no_grad()
    def step(self, shrink: Mapping[str, torch.Tensor] | None = None) -> None:
        """One step along the gradients, which are cleared.

        `shrink`: weights of an L1 norm of the parameters, in units of the loss, applied by its proximal map in Adam's
        metric: what the pictures do not hold at another value ends at exactly 0.
        """
        self._steps += 1
        bias = [1 - beta**self._steps for beta in BETAS]
        for name, p in self.parameters.items():
            if p.grad is None:
                continue
            first, second = self._moments.first[name], self._moments.second[name]
            first.lerp_(p.grad, 1 - BETAS[0])
            second.mul_(BETAS[1]).addcmul_(p.grad, p.grad, value=1 - BETAS[1])
            scale = (second / bias[1]).sqrt_().add_(self._epsilon)
            p.addcdiv_(first, scale, value=-self.rates[name] / bias[0])
            if shrink and name in shrink:
                threshold = self.rates[name] * shrink[name] / scale
                p.copy_(p.sign() * (p.abs() - threshold).clamp_min(0))
            p.grad = None

    def replace_values(self, name: str, values: torch.Tensor) -> None:
        """Give a parameter other values; its moments start at 0 again."""
        self.parameters[name] = values.detach().clone().requires_grad_(True)
        for moments in (self._moments.first, self._moments.second):
            moments[name] = torch.zeros_like(values)

    def state(self) -> dict[str, Any]:
        """A copy of everything that `restore` needs, as tensors and numbers."""
        columns = {"parameters": self.parameters, "first": self._moments.first, "second": self._moments.second}
        copies = {key: {n: p.detach().clone() for n, p in column.items()} for key, column in columns.items()}
        return copies | {"steps": self._steps}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from what `state` gave."""
        parameters, first, second = (
            {n: p.clone() for n, p in state[k].items()} for k in ("parameters", "first", "second")
        )
        self.parameters, self._moments, self._steps = _leaves(parameters), _Moments(first, second), state["steps"]

    def replace_rows(self, keep: torch.Tensor, added: Mapping[str, torch.Tensor] | None = None) -> None:
        """Keep the rows of a mask (N,), in order, and append new ones, whose moments start at 0."""
        detached = {name: p.detach() for name, p in self.parameters.items()}
        self.parameters = _leaves(take_and_append(detached, keep, added))
        zeros = None if added is None else zeros_like(added)
        first, second = self._moments.first, self._moments.second
        self._moments = _Moments(take_and_append(first, keep, zeros), take_and_append(second, keep, zeros))


def _leaves(parameters: Parameters) -> Parameters:
    return {name: p.requires_grad_(True) for name, p in parameters.items()}
