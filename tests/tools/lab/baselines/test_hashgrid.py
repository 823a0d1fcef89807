"""Fields of the baselines: what the hash encoding is, its gradient, and that a field learns and is sent whole."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import torch

from airgs_codec.errors import ConfigError
from tools.lab.baselines.hashgrid import FieldSettings, HashField

BOX = np.array([[-1.0, 0.0, 2.0], [1.0, 3.0, 2.5]])
SMALL = FieldSettings(levels=4, features=3, log2_table=7, coarsest=3, growth=1.6, width=8)  # 3, 4, 7 and 12 cells


def _points(count, seed=0):
    return np.random.default_rng(seed).uniform(*BOX, (count, 3))


def _entry(vertex, cells):
    """Number of a vertex in the table of its level, in plain integers."""
    i, j, k = (int(v) for v in vertex)
    if (cells + 1) ** 3 <= 128:
        return i + (cells + 1) * (j + (cells + 1) * k)
    return (i ^ (j * 2654435761) % 2**32 ^ (k * 805459861) % 2**32) % 128


def _encoded(field, point):
    """The features of one point, corner by corner."""
    unit = (point - BOX[0]) / (BOX[1] - BOX[0])
    table = field.table.detach().numpy()
    out, begin = [], 0
    for cells in (3, 4, 7, 12):
        total = np.zeros(table.shape[1])
        low = [min(int(u * cells), cells - 1) for u in unit]
        for corner in itertools.product((0, 1), repeat=3):
            weight = 1.0
            for axis in range(3):
                part = unit[axis] * cells - low[axis]
                weight *= part if corner[axis] else 1 - part
            total += weight * table[begin + _entry(np.add(low, corner), cells)]
        out.append(total)
        begin += min((cells + 1) ** 3, 128)
    return np.concatenate(out)


def test_features_are_interpolated_between_eight_vertices():
    field = HashField(SMALL, BOX, 2).double()
    points = np.concatenate([_points(50), BOX])
    expected = np.stack([_encoded(field, point) for point in points])
    np.testing.assert_allclose(field.encoded(field.places(points)).detach(), expected, rtol=1e-12, atol=1e-16)


def test_levels_that_fit_are_dense_and_others_share_a_table():
    assert SMALL.cells() == [3, 4, 7, 12]
    assert SMALL.entries() == [64, 125, 128, 128]
    assert len(HashField(SMALL, BOX, 1).table) == 445


def test_a_vertex_has_its_own_features():
    settings = FieldSettings(levels=1, features=2, log2_table=7, coarsest=4)
    field = HashField(settings, BOX, 1)
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [2, 3, 1], [4, 4, 4]])
    features = field.encoded(field.places(BOX[0] + vertices / 4 * (BOX[1] - BOX[0]))).detach()
    np.testing.assert_allclose(features, field.table.detach()[vertices @ [1, 5, 25]], atol=1e-9)


def test_a_point_outside_counts_as_the_nearest_of_the_box():
    field = HashField(SMALL, BOX, 2)
    inside, outside = np.array([[1.0, 1.5, 2.0]]), np.array([[7.0, 1.5, -5.0]])
    assert torch.equal(field(field.places(inside)), field(field.places(outside)))


def test_gradients_are_those_of_finite_differences():
    field = HashField(SMALL, BOX, 2, seed=3).double()
    with torch.no_grad():
        field.table.mul_(1e4)
    places = field.places(_points(20))
    weight = torch.linspace(-1, 2, 40, dtype=torch.float64).reshape(20, 2)

    def value():
        return (field(places) * weight).sum()

    value().backward()
    used = np.unique(places.weights.indices)[::29]
    for parameter, rows in [(field.table, used), (field.weights[0], [0, 5]), (field.biases[2], [0, 1])]:
        for row in rows:
            place = (int(row), *[0] * (parameter.ndim - 1))
            sides = []
            for step in (1e-6, -1e-6):
                with torch.no_grad():
                    parameter[place] += step
                    sides.append(float(value()))
                    parameter[place] -= step
            assert float(parameter.grad[place]) == pytest.approx((sides[0] - sides[1]) / 2e-6, rel=1e-4, abs=1e-7)


def test_a_field_learns_what_varies_in_space():
    field = HashField(FieldSettings(levels=4, log2_table=9, coarsest=3, width=16), BOX, 2, zero=True)
    points, others = _points(600), _points(200, seed=1)

    def truth(p):
        return torch.from_numpy(np.stack([np.sin(3 * p[:, 0]) * p[:, 1], np.cos(2 * p[:, 1])], 1).astype(np.float32))

    places, adam = field.places(points), torch.optim.Adam(field.parameters(), lr=1e-2)
    assert not field(places).any()
    for _ in range(150):
        adam.zero_grad()
        (field(places) - truth(points)).square().mean().backward()
        adam.step()
    error = (field(field.places(others)).detach() - truth(others)).square().mean()
    assert float(error) < 0.02 * float(truth(others).var())


def test_what_is_sent_is_every_number_in_float16():
    field, other = HashField(SMALL, BOX, 2, seed=1), HashField(SMALL, BOX, 2, seed=2)
    data = field.to_bytes()
    assert len(data) == 2 * (445 * 3 + 12 * 8 + 8 + 8 * 8 + 8 + 8 * 2 + 2)
    other.load_bytes(data)
    assert other.to_bytes() == data
    assert torch.equal(other.table, field.table.detach().half().float())
    with pytest.raises(ConfigError, match="3058 bytes of a field, got 6"):
        field.load_bytes(bytes(6))


def test_what_no_field_can_be_is_refused():
    with pytest.raises(ConfigError, match="volume"):
        HashField(SMALL, np.zeros((2, 3)), 1)
    with pytest.raises(ConfigError, match="growth"):
        FieldSettings(growth=0.5)
