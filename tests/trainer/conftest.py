"""What tests of the trainer share: threads as a run has them, and a scene that may be written to."""

import pytest
import torch

from tests.support.multiview_files import write_views
from tests.support.views import coloured_cloud, moved, ring


@pytest.fixture(scope="session", autouse=True)
def no_pool():
    torch.set_num_threads(1)


@pytest.fixture
def moving(tmp_path):
    g = coloured_cloud()
    frames = [g, moved(g, slice(0, 30), (0.1, 0, 0))]
    return write_views(tmp_path / "scene", frames, ring(6, held_out=1), g.means[:60])
