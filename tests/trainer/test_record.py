"""What a run leaves behind, and going on from there."""

import json
import shutil
from dataclasses import replace

import pytest

from airgs_codec.trainer.report import frames_to_show, training_answer
from tests.faces import ConfigError, FrameRecord, Record, TrainSettings, open_scene, train, with_near
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


def frame(number, psnr, held_out=None, **changes):
    """A record of a frame that moved, the first one but for number 0."""
    kind, exposed = "frame" if number else "first", None if held_out is None else held_out + 0.1
    plain = FrameRecord(number, kind, 900, 0, psnr, held_out, exposed, None, None, 2.0)
    return replace(plain, **changes)


def told(*frames):
    record = Record({}, TrainSettings().table(), len(frames), "30", frames)
    return training_answer(record, {"cam03": 27.0, "cam01": 30.0})


STEADY = [frame(t, 33.0 - 0.01 * t, 32.0 - 0.01 * t) for t in range(6)]
GUESSED = [frame(t, 36.0 - 0.1 * t, 31.0) for t in range(4)]
EXPOSED = [replace(f, held_out_matched=f.held_out_psnr + 2) for f in STEADY]
FALLING = [frame(t, 34.0 - t, 33.0 - t) for t in range(6)]
UNDONE = [frame(0, 32.0, 31.0), frame(1, 32.5, 31.0), frame(2, 32.5, 31.0)]


@pytest.mark.parametrize(
    ("frames", "field", "there", "absent"),
    [
        (STEADY, "good", "Cameras that were held out see 32.0 dB, those trained on 33.0 dB.", "This page fills"),
        (STEADY, "good", "900 Gaussians and took about 12 s", "of a budget"),
        (STEADY, "wrong", "Frame 5 is the worst with 31.9 dB, camera cam03 in it with 27.0.", "far below"),
        (STEADY, "change", "Nothing", ""),
        (STEADY, "useless", "", "keyframes"),
        ([frame(t, 33.0) for t in range(3)], "good", "none is held out", "held out see"),
        ([*STEADY[:5], frame(5, 33.0, 25.0)], "wrong", "far below", ""),
        (GUESSED, "wrong", "4.9 dB less than those trained on", ""),
        (GUESSED, "change", "--budget", ""),
        (EXPOSED, "wrong", "2.0 dB of the error are the exposure", ""),
        (EXPOSED, "change", "--match-exposure on", ""),
        (FALLING, "wrong", "last third of the frames shows 4.0 dB less", ""),
        (FALLING, "change", "--max-drop 1.5", ""),
        # A second frame only moves the first: where it shows more though the scene has moved, the first was not done.
        (UNDONE, "change", "0.50 dB more than the first", ""),
        (UNDONE, "change", "--iterations", ""),
        ([UNDONE[0], replace(UNDONE[1], kind="key"), UNDONE[2]], "change", "", "--iterations"),
        ([*STEADY[:5], replace(STEADY[5], rejected_psnr=20.0)], "useless", "1 keyframes were fitted", ""),
    ],
)
def test_every_sentence_is_said_where_the_frames_say_so(frames, field, there, absent):
    said = told(*frames)[field]
    assert there in said and (not absent or absent not in said)


def test_a_run_that_goes_on_says_how_long_and_budgets_are_told():
    record = Record({}, TrainSettings(budget=1000).table(), 10, "30", tuple(STEADY))
    good = training_answer(record, {"cam03": 27.0})["good"]
    assert good.startswith("6 of 10 frames are trained; the others take about 8 s. This page fills.")
    assert "900 Gaussians of a budget of 1,000" in good


def test_the_worst_frame_is_shown_and_another():
    assert frames_to_show(STEADY) == (0, 5)
    assert frames_to_show([frame(0, 20.0), frame(1, 30.0), frame(2, 30.0)]) == (2, 0)
    assert frames_to_show([frame(0, 20.0)]) == (0, 0)
