"""What the report of a training concludes: every sentence has data that say the opposite, and then it does."""

from dataclasses import replace

from airgs_codec.trainer.record import FrameRecord, Record
from airgs_codec.trainer.report import frames_to_show, training_answer
from airgs_codec.trainer.settings import TrainSettings


def frame(number, psnr, held_out=None, **changes):
    """A record of a frame that moved, the first one but for number 0."""
    kind, exposed = "frame" if number else "first", None if held_out is None else held_out + 0.1
    plain = FrameRecord(number, kind, 900, 0, psnr, held_out, exposed, None, None, 2.0)
    return replace(plain, **changes)


def told(*frames, **settings):
    record = Record({}, TrainSettings(**settings).table(), len(frames), "30", frames)
    return training_answer(record, {"cam03": 27.0, "cam01": 30.0})


STEADY = [frame(t, 33.0 - 0.01 * t, 32.0 - 0.01 * t) for t in range(6)]


def test_what_is_said_first_is_what_viewers_get():
    answer = told(*STEADY)
    assert answer["good"].startswith("Cameras that were held out see 32.0 dB, those trained on 33.0 dB.")
    assert "900 Gaussians and took about 12 s" in answer["good"] and "This page fills" not in answer["good"]
    assert answer["wrong"] == "Frame 5 is the worst with 31.9 dB, camera cam03 in it with 27.0."
    assert answer["change"].startswith("Nothing") and answer["useless"] == ""
    alone = told(*(frame(t, 33.0) for t in range(3)))
    assert "none is held out" in alone["good"] and "held out see" not in alone["good"]


def test_a_run_that_goes_on_says_how_long():
    record = Record({}, TrainSettings().table(), 10, "30", tuple(STEADY))
    good = training_answer(record, {"cam03": 27.0})["good"]
    assert good.startswith("6 of 10 frames are trained; the others take about 8 s. This page fills.")


def test_budgets_are_told_where_there_are_any():
    assert "900 Gaussians of a budget of 1,000" in told(*STEADY, budget=1000)["good"]


def test_a_frame_far_below_the_others_is_told_of():
    assert "far below" in told(*STEADY[:5], frame(5, 33.0, 25.0))["wrong"]
    assert "far below" not in told(*STEADY)["wrong"]


def test_what_no_camera_sees_is_guessed():
    answer = told(*(frame(t, 36.0 - 0.1 * t, 31.0) for t in range(4)))
    assert "4.9 dB less than those trained on" in answer["wrong"] and "--budget" in answer["change"]


def test_cameras_exposed_differently_are_told_of():
    answer = told(*(replace(f, held_out_matched=f.held_out_psnr + 2) for f in STEADY))
    assert "2.0 dB of the error are the exposure" in answer["wrong"] and "--match-exposure on" in answer["change"]


def test_quality_that_falls_asks_for_groups():
    answer = told(*(frame(t, 34.0 - t, 33.0 - t) for t in range(6)))
    assert "last third of the frames shows 4.0 dB less" in answer["wrong"] and "--max-drop 1.5" in answer["change"]


def test_a_fit_that_was_not_done_asks_for_iterations():
    """A second frame only moves the first: where it shows more though the scene has moved, the first was not done."""
    answer = told(frame(0, 32.0, 31.0), frame(1, 32.5, 31.0), frame(2, 32.5, 31.0))
    assert "0.50 dB more than the first" in answer["change"] and "--iterations" in answer["change"]
    key = told(frame(0, 32.0, 31.0), frame(1, 32.5, 31.0, kind="key"), frame(2, 32.5, 31.0))
    assert "--iterations" not in key["change"]


def test_keyframes_in_vain_are_of_no_use():
    assert "1 keyframes" not in told(*STEADY)["useless"]
    assert told(*STEADY[:5], replace(STEADY[5], rejected_psnr=20.0))["useless"].startswith("1 keyframes were fitted")


def test_the_worst_frame_is_shown_and_another():
    assert frames_to_show(STEADY) == (0, 5)
    assert frames_to_show([frame(0, 20.0), frame(1, 30.0), frame(2, 30.0)]) == (2, 0)
    assert frames_to_show([frame(0, 20.0)]) == (0, 0)
