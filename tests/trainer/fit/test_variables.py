"""Networks that move Gaussians, and Gaussians that move on their own."""

import pytest
import torch

from airgs_codec.trainer.fit.parameters import ATTRIBUTES, from_gaussians
from airgs_codec.trainer.fit.variables import HIDDEN, MlpDriven, Networks, PerGaussian
from tests.support.scenes import random_gaussians


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
