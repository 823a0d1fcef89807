"""The closed form for steps where it is ill-conditioned, and slopes that no step can be found from."""

import math

import pytest

from airgs_codec.encoder.calibrate import PRIOR, STEPS, balance
from airgs_codec.errors import SceneError

LARGEST = math.sqrt((1 + PRIOR) / PRIOR)


def slopes(errors: list[float]) -> dict[str, tuple[float, float]]:
    return {name: (1.0, error) for name, error in zip(STEPS, errors, strict=False)}


def test_equal_slopes_change_nothing() -> None:
    factors, price = balance(slopes([3.0] * 6))
    assert list(factors.values()) == pytest.approx([1.0] * 6)
    assert price == pytest.approx(2 * 3.0)


def test_a_step_without_error_grows_to_the_limit_and_one_without_bytes_shrinks_to_it() -> None:
    factors, _ = balance({"state.means": (1.0, 0.0), "state.opacity": (0.0, 1.0)})
    assert factors == {"state.means": pytest.approx(LARGEST), "state.opacity": pytest.approx(1 / LARGEST)}


@pytest.mark.parametrize("decades", [12, 300])
def test_errors_over_many_decades_keep_within_the_limit_and_in_order(decades: int) -> None:
    errors = [10.0 ** (-decades * i / 11) for i in range(12)]
    factors = list(balance(slopes(errors))[0].values())
    assert factors == sorted(factors)
    assert 1 / LARGEST <= factors[0] < 1 < factors[-1] <= LARGEST


@pytest.mark.parametrize("given", [{"grid": (0.0, 1.0)}, {"grid": (1.0, 0.0)}, {"grid": (-1.0, -1.0)}, {}])
def test_where_nothing_depends_on_steps_they_stay(given: dict[str, tuple[float, float]]) -> None:
    assert balance(given) == ({}, 0.0)


@pytest.mark.parametrize("slope", [(math.nan, 1.0), (1.0, math.inf), (1.0, math.nan)])
def test_slopes_that_are_not_finite_are_refused(slope: tuple[float, float]) -> None:
    with pytest.raises(SceneError, match=r"finite bytes and errors of grid, got"):
        balance({"state.means": (1.0, 1.0), "grid": slope})
