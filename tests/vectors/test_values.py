"""The decoder's numbers are as near to those of the vectors as FORMAT.md asks: keys, states, what is shown, regions."""

import numpy as np
import pytest
import torch

from airgs_codec.coding.atlas import line_times
from airgs_codec.coding.channels import Canonical, StateApplier, colours, dequantise_key
from airgs_codec.coding.motion import motion_units
from airgs_codec.coding.sidecar import KeySidecar
from airgs_codec.render.reference import sh_colours
from tests.faces import KEY, STATE, Grid, KeySteps, StateSteps, from_codes, to_matrices, unpack_matrix
from tests.support.vectors import assert_near, cases, float32, label

CHANNELS = (3, 12, 27, 48)  # of colour, by SH degree


def shown(g):
    return {
        "means": g.means,
        "quaternions": g.quaternions,
        "log_scales": g.log_scales,
        "alpha": 1 / (1 + np.exp(-g.opacity_logits.astype(np.float64))),
        "colours": colours(g.sh_dc, g.sh_rest),
    }


@pytest.mark.parametrize("case", cases("keys"), ids=label)
def test_keys(case):
    width, steps = CHANNELS[case["sh_degree"]], KeySteps(**case["steps"])
    codes = np.array(case["codes"], np.int32)
    values = from_codes(codes, KEY.steps(steps, width) * case["factor"], case["gain"])
    rows = codes.shape[1]
    sidecar = KeySidecar(*(np.zeros(rows, kind) for kind in (np.uint64, np.int16, np.int16, np.uint8)))
    transform = unpack_matrix(case["colour_transform"], width)
    key = dequantise_key(values, sidecar, transform, Grid(**case["grid"]), steps)
    names = {"quaternions": key.quaternions, "log_scales": key.log_scales, "alpha": key.opacity, "colours": key.colours}
    assert_near(names, case)


def canonical(case):
    space = case["canonical"]
    classes = np.array(space["classes"], np.int16)
    return Canonical(
        means=np.array(space["means"], np.float64),
        motion_units=motion_units(classes),
        quaternions=float32(space["quaternions"]),
        log_scales=float32(space["log_scales"]),
        opacity=float32(space["alpha"]),
        colours=float32(space["colours"]),
        depths=np.array(space["depths"], np.uint8),
        transform=unpack_matrix(case["colour_transform"], CHANNELS[case["sh_degree"]]),
    )


@pytest.mark.parametrize("case", cases("states"), ids=label)
def test_states(case):
    base, steps = canonical(case), StateSteps(**case["steps"])
    rows = np.flatnonzero((base.depths >= case["level"]) & (base.depths != 255))
    assert rows.tolist() == case["rows"]
    widths = STATE.steps(steps, CHANNELS[case["sh_degree"]]) * case["factor"]
    applier = StateApplier.of(base, rows, steps)
    for place, frame in enumerate(case["frames"]):
        codes = np.array(frame["codes"], np.int32)[:, : len(rows)]
        values = from_codes(codes, widths, case["gain"])
        if "slopes" in case:
            slopes = from_codes(np.array(case["slopes"], np.int32), widths, case["gain"])
            values += np.float32(line_times(len(case["frames"]))[place]) * slopes
        assert_near(shown(applier.apply(values)), frame)


def test_a_canonical_space_without_states_is_shown_alike():
    case = next(case for case in cases("states") if not case["rows"])
    assert_near(shown(canonical(case).to_gaussians()), case["frames"][0])


def test_covariances():
    for case in cases("shown", "covariances"):
        spread = to_matrices(np.array(case["quaternion"])) * np.exp(case["log_scales"])
        np.testing.assert_allclose(spread @ spread.T, case["covariance"], rtol=0, atol=case["tolerance"])


def test_colours_from_directions():
    for case in cases("shown", "colours"):
        directions, sh = (torch.tensor([case[name]], dtype=torch.float64) for name in ("direction", "coefficients"))
        np.testing.assert_allclose(sh_colours(directions, sh)[0], case["colour"], rtol=0, atol=case["tolerance"])
