"""What tests of the trainer share: scenes on disk and runs that are trained once."""

from dataclasses import replace

import pytest
import torch

from tests.faces import open_scene, train
from tests.support.multiview_files import write_views
from tests.support.training import SETTINGS, write_blobs
from tests.support.views import coloured_cloud, moved, ring


@pytest.fixture(scope="session", autouse=True)
def one_thread():
    """As in a run: the kernels have their own threads."""
    torch.set_num_threads(1)


@pytest.fixture
def moving(tmp_path):
    """A scene of two frames and six cameras, one of them held out."""
    g = coloured_cloud()
    frames = [g, moved(g, slice(0, 30), (0.1, 0, 0))]
    return write_views(tmp_path / "scene", frames, ring(6, held_out=1), g.means[:60])


@pytest.fixture(scope="session")
def blobs(tmp_path_factory):
    return write_blobs(tmp_path_factory.mktemp("scene") / "blobs")


@pytest.fixture(scope="session")
def run(blobs, tmp_path_factory):
    return train(open_scene(blobs), tmp_path_factory.mktemp("models") / "blobs", SETTINGS)


@pytest.fixture(scope="session")
def unbroken(blobs, tmp_path_factory, run):
    """Folders of unbroken runs by the setting `deltas`."""
    made = {"direct": run.folder}

    def get(deltas):
        if deltas not in made:
            folder = tmp_path_factory.mktemp("models") / deltas
            train(open_scene(blobs), folder, replace(SETTINGS, deltas=deltas))
            made[deltas] = folder
        return made[deltas]

    return get
