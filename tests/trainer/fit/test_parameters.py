"""Adam whose rows may come and go, and its L1 norm."""

import math

import pytest
import torch

from airgs_codec.trainer.fit.parameters import ATTRIBUTES, BETAS, Adam, from_gaussians
from airgs_codec.trainer.fit.variables import HIDDEN, MlpDriven, Networks, PerGaussian
from tests.support.scenes import random_gaussians
from tests.support.views import random_parameters


def test_adam_follows_torch():
    start = random_parameters(5)
    ours = Adam(start, dict.fromkeys(ATTRIBUTES, 0.01))
    theirs = {n: p.clone().requires_grad_() for n, p in start.items()}
    reference = torch.optim.Adam(theirs.values(), lr=0.01, betas=BETAS, eps=1e-12)
    generator = torch.Generator().manual_seed(0)
    for _ in range(20):
        for name in ATTRIBUTES:
            gradient = torch.randn(start[name].shape, generator=generator)
            ours.parameters[name].grad, theirs[name].grad = gradient.clone(), gradient.clone()
        ours.step()
        reference.step()
    for name in ATTRIBUTES:
        torch.testing.assert_close(ours.parameters[name].detach(), theirs[name].detach(), rtol=1e-5, atol=1e-6)


def test_rows_keep_their_moments_when_others_come_and_go():
    """The kept row goes on exactly as it would have alone."""
    rates = dict.fromkeys(ATTRIBUTES, 0.01)
    whole, alone = Adam(random_parameters(4), rates), Adam({n: p[2:3] for n, p in random_parameters(4).items()}, rates)
    for step in range(6):
        if step == 3:
            keep = torch.tensor([False, False, True, True])
            whole.replace_rows(keep, {n: p[:1] for n, p in random_parameters(3, seed=5).items()})
        for adam in (whole, alone):
            for p in adam.parameters.values():
                p.grad = torch.full_like(p, math.sin(step + 1))
            adam.step()
    row = 0
    for name in ATTRIBUTES:
        torch.testing.assert_close(whole.parameters[name][row], alone.parameters[name][0], rtol=0, atol=0)
        assert len(whole.parameters[name]) == 3


def test_shrinking_ends_at_the_minimum_of_the_l1_problem():
    """min (x - a)^2 / 2 + w |x| is at a - w, and exactly at 0 for |a| <= w."""
    wanted = torch.tensor([[1.0, 0.3, -0.05], [-0.8, 0.1, 0.0]])
    adam = Adam({"means": torch.zeros(2, 3)}, {"means": 0.02})
    weight = {"means": torch.full((2, 3), 0.1)}
    for step in range(800):
        adam.rates["means"] = 0.02 * 0.01 ** (step / 800)
        adam.parameters["means"].grad = adam.parameters["means"].detach() - wanted
        adam.step(weight)
    expected = torch.tensor([[0.9, 0.2, 0.0], [-0.7, 0.0, 0.0]])
    result = adam.parameters["means"].detach()
    torch.testing.assert_close(result, expected, rtol=0, atol=5e-3)
    assert (result[expected == 0] == 0).all()


def test_other_values_begin_without_moments():
    """A replaced parameter goes on as in an optimiser that has only just begun, but for the count of steps."""
    rates = dict.fromkeys(ATTRIBUTES, 0.01)
    adam = Adam(random_parameters(3), rates)
    push(adam, 1.0)
    before = {n: p.detach().clone() for n, p in adam.parameters.items()}
    adam.replace_values("opacity_logits", torch.zeros(3))
    push(adam, 0.0)
    assert adam.parameters["opacity_logits"].tolist() == [0.0, 0.0, 0.0]
    assert not torch.equal(adam.parameters["means"], before["means"])


def push(adam: Adam, gradient: float) -> None:
    """One step along a gradient that is the same everywhere."""
    for p in adam.parameters.values():
        p.grad = torch.full_like(p, gradient)
    adam.step()


@pytest.mark.parametrize("degree", [0, 1])
def test_networks_start_at_no_change_and_come_back_from_their_arrays(degree):
    base = from_gaussians(random_gaussians(30, degree))
    networks = Networks(base, 3.0, seed=1)
    assert ("sh_rest" in networks.names) == (degree > 0)
    current = MlpDriven(base, networks, None).current()
    assert all(torch.equal(current[n], base[n]) for n in ATTRIBUTES)
    with torch.no_grad():
        for last in networks.last:
            last.add_(0.1)
    other = Networks(base, 3.0, seed=2)
    other.load(networks.arrays())
    a, b = (n(n.features(base)) for n in (networks, other))
    assert all(torch.equal(a[n], b[n]) for n in networks.names)
    assert (a["means"].abs() > 0).any()


def test_rows_are_left_out_of_pictures_alone_and_the_more_the_longer_a_fit_goes_on():
    base = from_gaussians(random_gaussians(400, 1))
    variables = PerGaussian(base, 1.0, dropout=0.5)

    def hidden():
        return int((variables.current()["opacity_logits"] == HIDDEN).sum())

    assert hidden() == 0
    for iteration in (1, 2):
        variables.current()["means"].sum().backward()
        variables.step(iteration, 2)
    assert 120 < hidden() < 280
    assert not (variables.detached()["opacity_logits"] == HIDDEN).any()
