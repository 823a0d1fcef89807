"""What the report of a training concludes: every sentence has data that say the opposite, and then it does."""

from dataclasses import replace

import pytest

from airgs_codec.trainer.record import FrameRecord, Record
from airgs_codec.trainer.report import frames_to_show, training_answer
from airgs_codec.trainer.settings import TrainSettings


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
