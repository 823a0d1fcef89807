"""What a run leaves behind, and going on from there."""

import json
import shutil
from dataclasses import replace

import pytest

from airgs_codec.errors import ConfigError
from airgs_codec.trainer import train
from airgs_codec.trainer.data.multiview import with_near
from airgs_codec.trainer.data.readers import open_scene
from tests.support.training import APPEARS, SETTINGS


class StopError(Exception):
    """A run that is killed."""


def killed_at(frame: int, iteration: int):
    """`iteration`: of all fits of the frame, counted from 1."""
    past = 0

    def progress(what, done, total):
        nonlocal past
        past += what.startswith(f"training: frame {frame} ")
        if past == iteration:
            raise StopError

    return progress


def files(folder):
    """Everything that a run decides; seconds are the machine's."""
    found = {p.name: p.read_bytes() for p in folder.iterdir() if p.name != "training.json"}
    record = json.loads((folder / "training.json").read_text())
    for frame in record["frames"]:
        frame.pop("seconds")
    return found, record


@pytest.mark.parametrize(
    ("deltas", "killed"),
    [("direct", (0, 70)), ("direct", (APPEARS, 30)), ("mlp+residual", (2, 9)), ("mlp+residual", (4, 1))],
)
def test_a_killed_run_goes_on_to_the_same_end(blobs, tmp_path, deltas, killed, unbroken):
    settings = replace(SETTINGS, deltas=deltas)
    scene = open_scene(blobs)
    with pytest.raises(StopError):
        train(scene, tmp_path / "m", settings, progress=killed_at(*killed))
    assert len(list((tmp_path / "m").glob("*.ply"))) == killed[0]  # finished frames are there
    train(scene, tmp_path / "m", settings, resume=True)
    assert files(tmp_path / "m") == files(unbroken(deltas))


def test_a_run_killed_between_frame_and_record_repeats_that_frame(run, blobs, tmp_path):
    folder = tmp_path / "m"
    shutil.copytree(run.folder, folder)
    (folder / "usage.npz").unlink()
    record = json.loads((folder / "training.json").read_text())
    record["frames"].pop()
    (folder / "training.json").write_text(json.dumps(record))
    (folder / "000004.ply").write_bytes(b"half a frame")
    (folder / ".000004.ply.0123456789abcdef.part").write_bytes(b"half a frame")
    train(open_scene(blobs), folder, SETTINGS, resume=True)
    assert files(folder) == files(run.folder)


def test_a_finished_run_is_left_alone(run, blobs):
    before = {p.name: p.stat().st_mtime_ns for p in run.folder.glob("*.ply")}
    assert train(open_scene(blobs), run.folder, SETTINGS, resume=True).finished()
    assert {p.name: p.stat().st_mtime_ns for p in run.folder.glob("*.ply")} == before


def test_what_is_there_is_never_lost(run, blobs, tmp_path):
    scene = open_scene(blobs)
    with pytest.raises(ConfigError, match=r"resume .* goes on with"):
        train(scene, run.folder, SETTINGS)
    with pytest.raises(ConfigError, match="has budget 260, not 261"):
        train(scene, run.folder, replace(SETTINGS, budget=261), resume=True)
    with pytest.raises(ConfigError, match="the run there has cameras"):
        train(replace(scene, frames=tuple(f[:-1] for f in scene.frames)), run.folder, SETTINGS, resume=True)
    with pytest.raises(ConfigError, match="the run there has cameras"):
        train(with_near(scene, 0.5), run.folder, SETTINGS, resume=True)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.txt").write_text("mine")
    with pytest.raises(ConfigError, match="a folder with other files"):
        train(scene, tmp_path / "other", SETTINGS)
    assert (tmp_path / "other" / "thesis.txt").read_text() == "mine"


def test_the_quality_of_a_run_is_said_with_exposure_matched_where_it_differs(run):
    alike = replace(run.record, exposure={})
    assert "held out" in alike.quality() and "matched" not in alike.quality()
    exposed = replace(alike, exposure={"cam00": [1.1, 1.0, 1.0, 0.0, 0.0, 0.0]})
    assert exposed.quality().endswith(" with their exposure matched")
    first = replace(alike.frames[0], held_out_psnr=None, held_out_matched=None)
    trained = f"the trained model is itself at {first.psnr:.1f} dB to the pictures it was trained on"
    assert replace(exposed, frames=(first,)).quality() == f"qualities are those of the coding: {trained}"
