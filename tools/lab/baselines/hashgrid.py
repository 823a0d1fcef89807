"""A field over space: multi-resolution hash encoding (Müller et al. 2022) and a small MLP, trained in float32.

The points at which a field is read rarely change while it is fitted, so where they lie in the tables is found once, as
a sparse matrix of trilinear weights. A read is then one product with it, a gradient one product with its transpose: on
one core some twenty times faster than gathering and adding by index. P points, L levels, F features, E entries of all
tables, O outputs.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from airgs_codec.errors import ConfigError

PRIMES = np.array([1, 2_654_435_761, 805_459_861])  # of the spatial hash (Müller et al. 2022, equation 4)
CORNERS = np.array(list(itertools.product((0, 1), repeat=3)))  # (8, 3) of a cell
START = 1e-4  # features begin within +- this
WIRE = np.dtype("<f2")  # a number of a field as it is sent


@dataclass(frozen=True, slots=True)
class FieldSettings:
    levels: int = 8
    features: int = 4  # of an entry
    log2_table: int = 12  # most entries of a level, as a power of two
    coarsest: int = 8  # cells along each axis at the first level
    growth: float = 1.5  # ratio of the cells of one level to those before
    width: int = 64  # of a hidden layer
    hidden: int = 2  # layers

    def cells(self) -> list[int]:
        """Cells along each axis at each level, N_l (Müller et al. 2022, equation 2)."""
        return [math.floor(self.coarsest * self.growth**level) for level in range(self.levels)]

    def entries(self) -> list[int]:
        """Entries of each level: a vertex each where the table holds them all, else the size of the table."""
        return [min((cells + 1) ** 3, 2**self.log2_table) for cells in self.cells()]


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    weights: csr_matrix  # (P * L, E) trilinear, eight a row
    points: int  # P


class HashField(torch.nn.Module):
    def __init__(
        self, settings: FieldSettings, box: NDArray[np.floating], outputs: int, *, zero: bool = False, seed: int = 0
    ) -> None:
        """A field that has learnt nothing.

        `box`: (2, 3) its lowest and highest corner. `zero`: whether the output layer begins at 0, and with it every
        output. `seed`: of the first weights. Raises ConfigError for a box without volume.
        """
        super().__init__()
        if not bool((box[1] > box[0]).all()):
            raise ConfigError(f"expected a box with a volume, got {np.asarray(box).tolist()}")
        self.settings = settings
        self._box = np.asarray(box, np.float64)
        draw = torch.Generator().manual_seed(seed)
        entries = sum(settings.entries())
        self.table = torch.nn.Parameter(START * (2 * torch.rand(entries, settings.features, generator=draw) - 1))
        widths = [settings.levels * settings.features, *[settings.width] * settings.hidden, outputs]
        shapes = list(itertools.pairwise(widths))
        weights = [torch.randn(rows, columns, generator=draw) * math.sqrt(2 / rows) for rows, columns in shapes]
        if zero:
            weights[-1].zero_()
        self.weights = torch.nn.ParameterList(weights)
        self.biases = torch.nn.ParameterList([torch.zeros(columns) for _, columns in shapes])

    def places(self, positions: NDArray[np.floating]) -> Places:
        """Where `positions` (P, 3), in the units of the box, lie; one outside counts as the nearest one of the box.

        Vertices of a level that has fewer than its table holds are numbered in order, x first; others are hashed.
        """
        s = self.settings
        cells, entries = np.array(s.cells())[:, None], np.array(s.entries())
        unit = np.clip((positions - self._box[0]) / (self._box[1] - self._box[0]), 0, 1)
        scaled = unit[:, None] * cells  # (P, L, 3)
        low = np.minimum(np.floor(scaled), cells - 1)
        inside = (scaled - low)[:, :, None]
        vertices = low.astype(np.int64)[:, :, None] + CORNERS  # (P, L, 8, 3)
        dense = vertices @ np.stack([np.ones_like(cells), cells + 1, (cells + 1) ** 2], axis=1)
        index = np.where(
            ((cells[:, 0] + 1) ** 3 <= 2**s.log2_table)[:, None],
            dense[..., 0],
            np.bitwise_xor.reduce(vertices * PRIMES, axis=3) & (2**s.log2_table - 1),
        )
        index += (np.cumsum(entries) - entries)[:, None]
        weights = np.where(CORNERS == 1, inside, 1 - inside).prod(axis=3)
        ends = np.arange(0, index.size + 1, len(CORNERS))
        values = weights.astype(self.table.detach().numpy().dtype).ravel()
        shape = (len(positions) * s.levels, int(entries.sum()))
        return Places(csr_matrix((values, index.astype(np.int32).ravel(), ends), shape), len(positions))

    def encoded(self, places: Places) -> torch.Tensor:
        """(P, L * F) features of all levels, differentiable by the tables."""
        features: torch.Tensor = _Product.apply(self.table, places.weights)
        return features.reshape(places.points, -1)

    def forward(self, places: Places) -> torch.Tensor:
        """(P, O) outputs, differentiable by the tables and the MLP; not by the positions."""
        x = self.encoded(places)
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            x = torch.relu(torch.addmm(bias, x, weight))
        return torch.addmm(self.biases[-1], x, self.weights[-1])

    @property
    def nbytes(self) -> int:
        return WIRE.itemsize * sum(p.numel() for p in self.parameters())

    def to_bytes(self) -> bytes:
        """Every number as it is sent: float16, little-endian, tables first, then weights, then biases."""
        return b"".join(p.detach().numpy().astype(WIRE).tobytes() for p in self.parameters())

    def load_bytes(self, data: bytes) -> None:
        """Take the numbers that `to_bytes` of a field of the same sizes gave. Raises ConfigError for another length."""
        if len(data) != self.nbytes:
            raise ConfigError(f"expected {self.nbytes} bytes of a field, got {len(data)}")
        numbers = np.frombuffer(data, WIRE)
        at = 0
        with torch.no_grad():
            for p in self.parameters():
                p.copy_(torch.from_numpy(numbers[at : at + p.numel()].astype(np.float32)).reshape(p.shape))
                at += p.numel()


class _Product(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, table: torch.Tensor, weights: csr_matrix) -> torch.Tensor:
        ctx.weights = weights
        return torch.from_numpy(weights @ table.detach().numpy())

    @staticmethod
    def backward(ctx: Any, *grads: torch.Tensor) -> tuple[torch.Tensor, None]:
        return torch.from_numpy(ctx.weights.T @ grads[0].numpy()), None
