"""How many Gaussians a first frame has, where nobody says it."""

import pytest

from airgs_codec.trainer.data.multiview import Points
from airgs_codec.trainer.fit import first
from airgs_codec.trainer.fit.first import fit_first, usual_budget
from airgs_codec.trainer.fit.points import scene_extent
from airgs_codec.trainer.fit.trainer import FrameViews, Trainer
from airgs_codec.trainer.settings import TrainSettings
from tests.support.views import coloured_cloud, ring, views_of


@pytest.mark.parametrize(("size", "budget"), [(100, 8000), (400, 11429), (700, 35000), (2000, 64000)])
def test_larger_pictures_have_more_gaussians_within_bounds(size, budget):
    assert usual_budget(ring(8, size=size)) == budget


def test_a_first_frame_has_what_its_pictures_can_tell(monkeypatch):
    monkeypatch.setattr(first, "LEAST_BUDGET", 60)
    truth = coloured_cloud(400)
    trainer = Trainer(TrainSettings(sh_degree=0, first_iterations=150), scene_extent(ring()))
    found = fit_first(trainer, FrameViews(0, views_of(truth, ring(8, size=48))), Points(truth.means, None))
    assert 60 < len(found.gaussians) <= 48 * 48 / first.GAUSSIAN_PIXELS
