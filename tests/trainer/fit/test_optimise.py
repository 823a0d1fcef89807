"""The loop that fits: its losses, the order of views, pictures of half the size, and Adam whose rows come and go."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from airgs_codec.render import cpu
from airgs_codec.trainer.fit import losses, optimise
from airgs_codec.trainer.fit.optimise import HIDDEN, PerGaussian
from tests import faces
from tests.faces import ATTRIBUTES, Adam, Gaussians, InMotion, Target, TrainingError, View, from_gaussians, open_scene
from tests.support.scenes import random_gaussians
from tests.support.views import coloured_cloud, moved, random_parameters, ring, views_of, windowed_ssim


def fit(g, shown, iterations, **more):
    fitted, schedule = PerGaussian(from_gaussians(g), 5.0), optimise.Schedule("fit", iterations, lambda _: 0, **more)
    optimise.optimise(fitted, shown, schedule, np.random.default_rng(0))
    return fitted.detached()


def test_a_fit_is_the_same_whatever_is_kept_in_memory(moving):
    many, few = (faces.Pictures(open_scene(moving), memory=(n, n)) for n in (1 << 30, 1))
    a, b = (fit(coloured_cloud(30), pictures.train(0), 12) for pictures in (many, few))
    assert few.nbytes < 48 * 48 * (3 + 36) + 1  # one of each
    assert all(torch.equal(a[name], b[name]) for name in a)


def test_views_are_all_seen_before_any_comes_again():
    order = list(itertools.islice(optimise.shuffled(7, np.random.default_rng(0)), 42))
    assert [sorted(order[i : i + 7]) for i in range(0, 42, 7)] == [list(range(7))] * 6


def test_losses_that_are_not_finite_end_a_fit_and_name_the_first_fault_though_they_are_looked_at_seldom():
    views, early, late = views_of(coloured_cloud(5), ring(2)), optimise.LossCheck(50), optimise.LossCheck(50)
    for iteration in range(1, 50):
        early.add(iteration, views, torch.tensor(math.nan if iteration in (7, 30) else 1.0), last=False)
    with pytest.raises(TrainingError, match="iteration 7 in view cam00, cam01"):
        early.add(50, views, torch.tensor(1.0), last=False)
    with pytest.raises(TrainingError, match="iteration 3 in view cam01"):
        late.add(3, views[1:], torch.tensor(math.inf), last=True)
    views[0].target.rgb[:] = views[1].target.rgb[:] = np.nan
    with pytest.raises(TrainingError, match="iteration 1 in view cam0"):
        fit(coloured_cloud(20), views, 5)


def test_an_iteration_of_several_pictures_follows_the_mean_of_their_losses():
    g = coloured_cloud(30)
    views = views_of(moved(g, slice(0, 10), (0.1, 0, 0)), ring(3))
    together, by_hand = fit(g, views, 1, views=3), PerGaussian(from_gaussians(g), 5.0)
    parts = [losses.render_views(by_hand.current(), [v.camera], 0)[0] for v in views]
    sum(losses.photometric(rgb, [v.target]) / 3 for rgb, v in zip(parts, views, strict=True)).backward()
    by_hand.step(1, 1)
    for name, value in together.items():
        torch.testing.assert_close(value, by_hand.detached()[name], atol=1e-4, rtol=1e-3)
    assert not torch.equal(together["means"], from_gaussians(g)["means"])


def test_each_of_several_pictures_shows_the_time_it_was_taken_at():
    g, motion = coloured_cloud(30), np.full((30, 3), 0.1, np.float32)
    views = [replace(v, after=after) for v, after in zip(views_of(g, ring(3)), (0.0, -0.5, 0.25), strict=True)]
    pictures = optimise.drawn(PerGaussian(losses.with_motion(from_gaussians(g), views, motion), 5.0), views, 0)
    for (place,), (rgb,) in pictures:
        view = views[place]
        shown = losses.render(from_gaussians(InMotion(g, motion).at(view.after)), view.camera, 0)[0]
        torch.testing.assert_close(rgb, shown, atol=1e-5, rtol=0)
    assert optimise.halve(views[1]).after == -0.5


CAMERA = faces.look_at(np.array([0.3, 0.2, -4.0]), np.zeros(3), np.array([0.0, 1, 0]), size=75, fov_y=0.9, name="odd")
SCENE = replace(coloured_cloud(60), log_scales=np.full((60, 3), np.log(0.25), np.float32))


def test_a_halved_camera_sees_what_its_halved_picture_shows_and_tiles_are_drawn_again_where_one_of_four_was():
    whole, tiles = cpu.render(SCENE, CAMERA), np.zeros((5, 5), np.bool_)
    tiles[1, 4] = tiles[4, 0] = True
    redraw = faces.Redraw(tiles, lambda: whole, np.ones(len(SCENE), np.bool_))
    half = optimise.halve(View(CAMERA, Target(whole.rgb, np.zeros((75, 75), np.float32)), redraw))
    assert half.target.rgb.shape == half.redraw.rest().rgb.shape == (38, 38, 3)
    assert half.target.clear.shape == half.redraw.rest().transmittance.shape == (38, 38)
    drawn = cpu.render(SCENE, half.camera).rgb
    error, beside = (np.abs(picture - half.target.rgb).mean() for picture in (drawn, np.roll(drawn, 1, axis=1)))
    assert error < 0.2 * beside
    assert np.argwhere(half.redraw.tiles).tolist() == [[0, 2], [2, 0]]


def test_pictures_that_are_small_on_either_side_are_not_halved():
    target = Target(np.zeros((1, 1, 3), np.float32))
    views = [View(faces.with_pixels(CAMERA, *size), target) for size in ((160, 200), (159, 400))]
    assert optimise.can_be_halved(views[:1]) and not optimise.can_be_halved(views)


def fitted(start, target):
    views = views_of(target, ring(2, size=32))
    after = losses.to_gaussians(fit(start, views, 30))
    assert all(np.isfinite(getattr(after, name)).all() for name in after.__slots__)
    return after, losses.mean_psnr(after, views) - losses.mean_psnr(start, views)


def stretched(ratio):
    """Blobs one axis of which is `ratio` times as long as the others."""
    g = coloured_cloud(6)
    short = np.log(0.4) - np.log(ratio) * np.array([0, 1, 1])
    turns = np.random.default_rng(0).normal(size=(6, 4)).astype(np.float32)
    return replace(g, log_scales=np.tile(short, (6, 1)).astype(np.float32), quaternions=turns)


@pytest.mark.parametrize(("ratio", "norm", "shift"), [
    (1e3, 1, 0.02), (1e6, 1, 0.02), *((3.0, norm, 0.0) for norm in (1e-20, 1e-6, 1e15, 1e25)),
])  # fmt: skip
def test_needles_and_quaternions_of_any_length_train(ratio, norm, shift):
    g = stretched(ratio)
    target = replace(g, quaternions=g.quaternions * np.float32(norm))
    after, gain = fitted(replace(target, sh_dc=target.sh_dc + 0.3, means=target.means + np.float32(shift)), target)
    assert gain > 2
    assert norm != 1e-20 or (after.quaternions == target.quaternions).all()  # the identity, which has no gradient


@pytest.mark.parametrize("norm", [1e-9, 1e18, 1e20, 1e38])
def test_long_and_short_quaternions_are_drawn_as_unit_ones(norm):
    g = stretched(30.0)
    unit = g.quaternions / np.linalg.norm(g.quaternions, axis=1, keepdims=True)
    shown = [cpu.render(replace(g, quaternions=q), ring(2, size=32)[0]).rgb for q in (unit, unit * np.float32(norm))]
    assert shown[0].max() > 0.1
    np.testing.assert_allclose(shown[1], shown[0], atol=1e-4)


def test_what_is_too_faint_to_be_drawn_stays_as_it_is():
    g, faint = coloured_cloud(6), np.full(6, -14.0, np.float32)
    after, _ = fitted(replace(g, opacity_logits=faint), g)
    assert (after.opacity_logits == faint).all() and (after.means == g.means).all()


def test_rows_in_one_place_part():
    g = coloured_cloud(4)
    twice = g.take(np.tile(np.arange(4), 2))
    apart = replace(twice, means=twice.means + np.repeat([[-0.03], [0.03]], 4, axis=0).astype(np.float32))
    target = replace(apart, sh_dc=np.concatenate([g.sh_dc, -g.sh_dc]), opacity_logits=np.zeros(8, np.float32))
    after, gain = fitted(replace(twice, opacity_logits=np.zeros(8, np.float32)), target)
    assert gain > 2
    assert np.abs(after.sh_dc[:4] - after.sh_dc[4:]).max() > 0.01


@pytest.mark.parametrize(("column", "value"), [
    ("opacity_logits", [100, -100, 20, -20, 0, 50, -50, 5, -5, 1]),
    ("log_scales", -30), ("log_scales", 8), ("quaternions", 0),
])  # fmt: skip
def test_extreme_rows_stay_finite_in_a_fit(column, value):
    g = coloured_cloud(40)
    extreme = getattr(g, column).copy()
    extreme[:10] = value
    assert fitted(replace(g, **{column: extreme}), g)[0].log_scales.max() <= np.log(5.0) + 1e-5


RATES = dict.fromkeys(ATTRIBUTES, 0.01)


def push(adam, gradient):
    for p in adam.parameters.values():
        p.grad = torch.full_like(p, gradient)
    adam.step()


@pytest.mark.parametrize("size", [1, 1e-10])
def test_adam_follows_torch_whatever_the_size_of_gradients(size):
    """With the usual epsilon of 1e-8, rows of gradients far below those of pictures would hardly move."""
    start = random_parameters(5)
    ours = Adam(start, RATES)
    theirs = {n: p.clone().requires_grad_() for n, p in start.items()}
    reference = torch.optim.Adam(theirs.values(), lr=0.01, betas=(0.9, 0.999), eps=1e-12)
    generator = torch.Generator().manual_seed(0)
    for _ in range(20):
        for name in ATTRIBUTES:
            gradient = size * torch.randn(start[name].shape, generator=generator)
            ours.parameters[name].grad, theirs[name].grad = gradient.clone(), gradient.clone()
        ours.step()
        reference.step()
    for name in ATTRIBUTES:
        torch.testing.assert_close(ours.parameters[name].detach(), theirs[name].detach(), rtol=1e-5, atol=1e-6)


def test_rows_keep_their_moments_when_others_come_and_go():
    start = random_parameters(4)
    whole, alone = Adam(start, RATES), Adam({name: p[2:3] for name, p in start.items()}, RATES)
    for step in range(6):
        if step == 3:
            keep = torch.tensor([False, False, True, True])
            whole.replace_rows(keep, {n: p[:1] for n, p in random_parameters(3, seed=5).items()})
        for adam in (whole, alone):
            push(adam, math.sin(step + 1))
    for name in ATTRIBUTES:
        torch.testing.assert_close(whole.parameters[name][0], alone.parameters[name][0], rtol=0, atol=0)
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


@pytest.mark.parametrize(("levels", "shape", "tolerance"), [
    *((None, shape, 1e-5) for shape in ((16, 16), (7, 33), (40, 5), (1, 1))),
    (255, (20, 30), 1e-4), (1000, (20, 30), 1e-4),  # as on CUDA, on tensors of the CPU; pictures of bytes, and finer
])  # fmt: skip
def test_losses_and_their_gradients_equal_the_definition(levels, shape, tolerance, monkeypatch):
    monkeypatch.setattr(losses.cuda, "by_gsplat", lambda _: levels is not None)
    pictures, truths = np.random.default_rng(0).uniform(0, 1, (2, 2, *shape, 3)).astype(np.float32)
    truths = np.rint(truths * np.float32(levels)) / np.float32(levels) if levels else truths
    x, views = torch.from_numpy(pictures).requires_grad_(), [View(CAMERA, Target(truth)) for truth in truths]
    targets = [view.target for view in (losses.uploaded(views, x.device) if levels else views)]
    assert not levels or {target.dtype for target in targets} == {torch.uint8 if levels == 255 else torch.float32}
    losses.photometric(x, targets, 0.2).mean().backward()
    y, t = torch.from_numpy(pictures).double().requires_grad_(), torch.from_numpy(truths).double()
    error = (y - t).abs().mean(dim=(1, 2, 3))
    similar = torch.stack([windowed_ssim(*pair) for pair in zip(y, t, strict=True)])
    (0.8 * error + 0.2 * (1 - similar)).mean().backward()
    assert (x.grad - y.grad).norm() <= tolerance * y.grad.norm()
    for weight, expected in ((0.0, error), (0.2, 0.8 * error + 0.2 * (1 - similar)), (1.0, 1 - similar)):
        found = losses.photometric(x, targets, weight)
        torch.testing.assert_close(found.double(), expected, rtol=tolerance, atol=tolerance * (weight == 1))


def test_equal_pictures_have_no_loss_and_black_ones_a_finite_gradient():
    x = torch.zeros((1, 12, 12, 3)).requires_grad_()
    compared = losses.photometric(x, [Target(np.zeros((12, 12, 3), np.float32))])
    compared.backward()
    assert compared.item() == pytest.approx(0, abs=1e-6)
    assert torch.isfinite(x.grad).all() and x.grad.abs().max() < 1e-6


def test_codec_steps_are_positive_and_finite_at_extremes():
    g = random_gaussians(12, 1)
    logits = np.array([0, 100, -100, 20, -20, 1, 2, 3, 4, 5, 6, 7], np.float32)
    lengths = np.repeat([1e-3, 1e20], 6).astype(np.float32)
    g = Gaussians(g.means, g.quaternions * lengths[:, None], g.log_scales, logits, g.sh_dc, g.sh_rest)
    steps = losses.codec_steps(g, ring(3))
    for name in ATTRIBUTES:
        assert steps[name].shape == getattr(g, name).shape
        assert torch.isfinite(steps[name]).all() and (steps[name] > 0).all()
    assert steps["opacity_logits"][0] == pytest.approx(0.058 * 4)
    lengths = np.linalg.norm(g.quaternions.astype(float), axis=1, keepdims=True)
    half = faces.StepSettings().delta.quaternions / 2 * lengths
    np.testing.assert_allclose(steps["quaternions"], np.broadcast_to(half, (12, 4)), rtol=1e-5)


@pytest.mark.parametrize(("unit", "over"), [("step", 0), ("sum", 1), ("gaussians", 2), ("elements", 6)])
def test_temporal_weights_have_the_unit_they_say(unit, over):
    steps = {"means": torch.tensor([[0.5, 0.5, 0.5], [2.0, 2.0, 2.0]])}
    found = losses.temporal_weights(faces.Temporal(0.4, unit), steps)["means"]
    assert found.tolist() == [pytest.approx([weight] * 3) for weight in ([0.4 / over] * 2 if over else [0.4, 0.1])]


@pytest.mark.parametrize(("sides", "differs"), [((1.05, 1.05), True), ((1.05, 0.95), False)])
def test_exposure_is_one_only_where_both_halves_of_pictures_ask_for_it(sides, differs):
    gains = np.repeat(sides, 8).astype(np.float32)[None, :, None]
    grey = torch.full((8, 16, 3), 0.5)
    model = optimise.ExposureModel(2, "cpu", looks=60)
    for i in range(60):
        target = grey.numpy() * (gains if i % 2 else 2 - gains)
        (model.apply(grey[None], [i % 2])[0] - torch.from_numpy(target)).abs().mean().backward()
        model.step()
    assert model.differs == differs


def test_gains_of_a_picture_are_matched_only_where_its_halves_agree():
    g = coloured_cloud()
    view = views_of(g, ring(1))[0]
    for gain in (np.full(48, 0.7), np.repeat((0.7, 1.0), 24)):
        dark = replace(view, picture=Target(view.target.rgb * gain.astype(np.float32)[None, :, None]))
        better = losses.matched_psnr(g, [dark]) - losses.mean_psnr(g, [dark])
        assert better > 20 if gain[-1] < 1 else better == 0
