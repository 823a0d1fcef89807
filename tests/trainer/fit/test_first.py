"""How many Gaussians a first frame has, where nobody says it."""

import pytest

from airgs_codec.trainer.data.multiview import Points
from airgs_codec.trainer.fit import first
from airgs_codec.trainer.fit.first import fit_first
from airgs_codec.trainer.fit.points import scene_extent
from airgs_codec.trainer.fit.trainer import FrameViews, Trainer
from airgs_codec.trainer.frames import with_last
from airgs_codec.trainer.settings import TrainSettings
from tests.support.views import coloured_cloud, ring, views_of

LEAST = 60


@pytest.fixture
def small_budgets(monkeypatch):
    monkeypatch.setattr(first, "LEAST_BUDGET", LEAST)
    monkeypatch.setattr(first, "MOST_BUDGET", 4 * LEAST)
    monkeypatch.setattr(first, "GROWN_ITERATIONS", 200)


def fitted(truth, cameras=8):
    trainer = Trainer(TrainSettings(sh_degree=0, first_iterations=200), scene_extent(ring()))
    return fit_first(trainer, FrameViews(0, views_of(truth, ring(cameras))), Points(truth.means[:20], None))


def test_what_more_gaussians_show_better_gets_more(small_budgets):
    many = coloured_cloud(400)
    assert 2 * LEAST < len(fitted(many)) <= 4 * LEAST


def test_what_few_show_as_well_keeps_few(small_budgets):
    assert len(fitted(coloured_cloud(5))) <= LEAST


def test_nothing_is_held_back_from_few_views(small_budgets, monkeypatch):
    monkeypatch.setattr(first, "matched_psnr", None)
    assert len(fitted(coloured_cloud(400), cameras=7)) <= LEAST


def test_views_that_are_held_back_lie_between_others_and_come_last():
    views = list(range(19))
    found = with_last(views, 8)
    assert found[-2:] == [4, 12] and sorted(found) == views and found[:-2] == sorted(found[:-2])
    assert with_last(views[:7], 8) == views[:7]


def test_all_views_are_in_the_fit_that_is_taken(small_budgets, monkeypatch):
    seen = []
    fit = first.optimise

    def watched(variables, views, schedule, *more):
        seen.append((schedule.stage, len(views)))
        fit(variables, views, schedule, *more)

    monkeypatch.setattr(first, "optimise", watched)
    gains = iter([30.0, 29.0, 30.1, 30.0])  # twice as many are better once, and then no more
    monkeypatch.setattr(first, "matched_psnr", lambda *_: next(gains))
    fitted(coloured_cloud(60))
    assert seen == [
        ("first frame", 8), ("60 Gaussians", 7), ("120 Gaussians", 7), ("120 Gaussians", 8), ("120 Gaussians", 7),
        ("240 Gaussians", 7),
    ]  # fmt: skip
