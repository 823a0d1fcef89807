"""4DGS: the HexPlane against a plain reference, what is learnt, what is fetched, and runs that stop."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
import torch

from airgs_codec.errors import ConfigError
from airgs_codec.progress import silent
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.trainer.data.pictures import Pictures
from airgs_codec.trainer.data.readers import open_scene
from airgs_codec.trainer.fit.losses import mean_psnr
from tests.support.multiview_files import write_views
from tests.support.views import coloured_cloud, moved, ring
from tools.lab.baselines import fourdgs
from tools.lab.baselines.fourdgs import (
    MODEL,
    PAIRS,
    TIME,
    Field,
    FieldSize,
    Fit,
    Fourdgs,
    PlaneWeights,
    deformed,
    field_from,
    moment,
    plane_loss,
    read_model,
    spread,
    write_model,
)
from tools.lab.baselines.method import Footage

SIZE = FieldSize(cells=5, moments=3, features=2, resolutions=(1, 2), width=4)
LOW, HIGH = torch.tensor([-1.0, -2.0, 0.0]), torch.tensor([1.0, 2.0, 3.0])
SMALL = Fourdgs(iterations=300, sh_degree=0, points=60, cells=16)
FRAMES = 3


@pytest.fixture(scope="module")
def swing(tmp_path_factory):
    """Half of a cloud moves by three of its radii."""
    folder = tmp_path_factory.mktemp("swing")
    g = coloured_cloud(60)
    frames = [moved(g, slice(0, 30), (0.3 * t, 0.0, 0.0)) for t in range(FRAMES)]
    write_views(folder, frames, ring(7, size=32, held_out=1), g.means)
    return folder


def footage_of(swing, folder):
    scene = open_scene(swing)
    return Footage(Pictures(scene), FRAMES, scene.points, folder)


def shaken(field: Field) -> Field:
    """With other numbers everywhere, as if it had learnt."""
    draw = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for p in field.parameters():
            p.add_(0.3 * torch.randn(p.shape, generator=draw))
    return field


def held_out_psnr(footage: Footage, frames: list[Gaussians]) -> float:
    return float(np.mean([mean_psnr(g, footage.pictures.held_out(t)) for t, g in enumerate(frames)]))


def bilinear(plane, column, row):
    """(F,) of a plane (F, rows, columns) at places of -1..1, corner by corner."""
    total = np.zeros(len(plane))
    size = np.array(plane.shape[1:])
    at = (np.clip([row, column], -1, 1) + 1) / 2 * (size - 1)
    first = np.minimum(at.astype(int), size - 2)
    for corner in itertools.product((0, 1), repeat=2):
        weight = np.prod(1 - np.abs(at - first - corner))
        total += weight * plane[:, *(first + corner)]
    return total


def test_features_are_products_of_six_planes_at_each_resolution():
    field = shaken(Field(SIZE, LOW, HIGH, 0))
    points = torch.rand(6, 3) * 1.4 * (HIGH - LOW) + LOW  # some are beyond the box
    features = field.encode(points, 0.3).detach().numpy()
    assert features.shape == (6, SIZE.features * 2)
    for point, found in zip(points.numpy(), features, strict=True):
        place = [*(2 * (point - LOW.numpy()) / (HIGH - LOW).numpy() - 1), 2 * 0.3 - 1]
        wanted = []
        for k in range(2):
            product = np.ones(SIZE.features)
            for pair, plane in zip(PAIRS, field.planes[6 * k : 6 * k + 6], strict=True):
                product *= bilinear(plane[0].detach().numpy(), place[pair[0]], place[pair[1]])
            wanted.append(product)
        assert found == pytest.approx(np.concatenate(wanted), rel=1e-4, abs=1e-5)


def test_planes_are_the_six_pairs_and_only_space_gets_finer():
    shapes = [tuple(plane.shape[2:]) for plane in Field(SIZE, LOW, HIGH, 0).planes]
    assert sorted(PAIRS) == [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    for k, cells in enumerate((5, 10)):
        assert shapes[6 * k : 6 * k + 6] == [(3, cells) if TIME in pair else (cells, cells) for pair in PAIRS]


def test_a_new_field_deforms_nothing():
    g = coloured_cloud(8)
    shown = deformed(g, Field(SIZE, LOW, HIGH, 0), 0.7)
    assert all(np.array_equal(getattr(shown, n), getattr(g, n)) for n in g.__slots__)


def test_a_field_moves_and_turns_and_scales_but_never_fades():
    g = coloured_cloud(8)
    shown = deformed(g, shaken(Field(SIZE, LOW, HIGH, 0)), 0.7)
    changed = {n for n in g.__slots__ if not np.array_equal(getattr(shown, n), getattr(g, n))}
    assert changed == {"means", "log_scales", "quaternions"}


def test_planes_pay_for_bends_along_rows_and_planes_of_time_for_change():
    field = Field(FieldSize(cells=4, moments=4, features=1, resolutions=(1,)), LOW, HIGH, 0)
    with torch.no_grad():
        for pair, plane in zip(PAIRS, field.planes, strict=True):
            plane.copy_(torch.arange(4.0)[:, None].expand(4, 4) if TIME not in pair else torch.ones(4, 4))
        assert float(plane_loss(field, PlaneWeights())) == 0  # a slope has no second difference
        field.planes[PAIRS.index((1, TIME))][0, 0, 3] = 3.0
        bend, change = 4 * 2.0**2 / 8, 2.0 / 4
    loss = plane_loss(field, PlaneWeights(0.0, 0.5, 0.25)).item()
    assert loss == pytest.approx(0.5 * bend + 0.25 * change)


def test_the_model_comes_back_from_its_files_exactly(tmp_path):
    g, field = coloured_cloud(8), shaken(Field(SIZE, LOW, HIGH, 0))
    total = write_model(tmp_path / MODEL, g, field)
    assert total == sum(path.stat().st_size for path in (tmp_path / MODEL).iterdir())
    back, again = read_model(tmp_path / MODEL)
    shown, wanted = deformed(back, again, 0.4), deformed(g, field, 0.4)
    assert all(np.array_equal(getattr(shown, n), getattr(wanted, n)) for n in g.__slots__)
    assert field_from(field.arrays()).arrays().keys() == field.arrays().keys()
    assert total > 4 * sum(p.numel() for p in field.parameters())
    assert sum(spread(total, 7)) == total and max(spread(total, 7)) - min(spread(total, 7)) <= 1


def test_it_follows_what_moves(swing, tmp_path, monkeypatch):
    footage = footage_of(swing, tmp_path / "moving")
    moving = list(replace(SMALL, rate=4.0).frames(footage, 0, silent))
    monkeypatch.setattr(fourdgs, "COARSE", fourdgs.COARSE + fourdgs.FINE)
    monkeypatch.setattr(fourdgs, "FINE", 0)
    still = footage_of(swing, tmp_path / "still")
    static = list(SMALL.frames(still, 0, silent))
    assert np.array_equal(static[0].gaussians.means, static[2].gaussians.means)
    gain = held_out_psnr(footage, [s.gaussians for s in moving]) - held_out_psnr(still, [s.gaussians for s in static])
    assert gain > 2
    model = sum(path.stat().st_size for path in (footage.folder / MODEL).iterdir())
    assert sum(s.bytes for s in moving) == model
    assert [s.kind for s in moving] == ["key", "frame", "frame"]


def test_a_stopped_run_goes_on_from_its_checkpoint(swing, tmp_path, monkeypatch):
    monkeypatch.setattr(fourdgs, "KEEP_EVERY", 10)
    method = replace(SMALL, iterations=60)
    whole = [s.gaussians for s in method.frames(footage_of(swing, tmp_path / "whole"), 0, silent)]

    def killed(stage, done, total):
        if done == 34:
            raise KeyboardInterrupt

    stopped = footage_of(swing, tmp_path / "stopped")
    with pytest.raises(KeyboardInterrupt):
        next(method.frames(stopped, 0, killed))
    assert Fit(method, stopped).iteration == 30
    on = [s.gaussians for s in method.frames(stopped, 0, silent)]
    later = [s.gaussians for s in method.frames(stopped, 1, silent)]
    for a, b in zip(whole, on, strict=True):
        assert np.array_equal(a.means, b.means) and np.array_equal(a.sh_dc, b.sh_dc)
    assert len(later) == FRAMES - 1 and np.array_equal(later[0].means, whole[1].means)
    with pytest.raises(ConfigError, match="checkpoint"):
        Fit(replace(method, rate=2.0), stopped)


def test_time_runs_from_0_to_1():
    assert [moment(t, 3) for t in range(3)] == [0.0, 0.5, 1.0]
    assert moment(0, 1) == 0.0
