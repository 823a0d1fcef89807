"""Usage of a trained model."""

import numpy as np
import pytest

from airgs_codec.analysis.grouping import plan_groups
from airgs_codec.analysis.sensitivity import measure_usage
from airgs_codec.encoder.survey import GroupSpan, ViewPlan, survey_group
from airgs_codec.errors import SceneError
from airgs_codec.render import measure_contribution
from airgs_codec.render.backend import CPU
from airgs_codec.scene.beside import load_usage
from airgs_codec.scene.sequence import open_sequence
from airgs_codec.trainer.capture import group_usage
from airgs_codec.trainer.data.pictures import pictures_for
from airgs_codec.trainer.data.readers import open_scene
from airgs_codec.trainer.fit.losses import codec_steps
from airgs_codec.trainer.record import FrameRecord, Record, TrainedFrame, open_model
from airgs_codec.trainer.settings import TrainSettings
from tests.support.multiview_files import write_views
from tests.support.views import coloured_cloud, moved, ring


def test_usage_is_of_all_frames_and_the_encoder_takes_it(run):
    sequence = open_sequence(run.folder)
    training = [c for c in sequence.cameras if c.split == "train"]
    (start, stop) = plan_groups(sequence).spans[0]
    saved = sequence.usage(start, stop)
    measured = measure_usage([sequence.read(t) for t in range(start, stop)], training)
    np.testing.assert_allclose(saved.total, measured.total)
    np.testing.assert_array_equal(saved.hits, measured.hits)
    assert saved.moved.min() >= 0 and saved.moved.max() > 0
    survey = survey_group(sequence, GroupSpan(0, start, stop), ViewPlan.of(sequence, 24))
    assert survey.usage.total.tolist() == saved.total.tolist()
    assert sequence.usage(0, 2) is None  # another group: measured anew


def test_usage_that_is_broken_is_refused(run, tmp_path):
    path = tmp_path / "usage.npz"
    path.write_bytes(b"PK\x03\x04 broken")
    with pytest.raises(SceneError, match=r"usage\.npz: expected usage"):
        load_usage(path, 0, 3, 10)


def test_motion_is_measured_against_the_middle_frame(tmp_path):
    """The codec's differences start there: a row that is elsewhere in the middle frame alone moves in all others."""
    g = coloured_cloud(40)
    frames = [g, g, moved(g, slice(0, 1), (0.2, 0.0, 0.0)), g]
    scene = open_scene(write_views(tmp_path / "scene", frames, ring(3), None))
    settings = TrainSettings(sh_degree=0)
    wanted = Record({}, settings.table(), len(frames), "30")
    model = open_model(tmp_path / "model", wanted, resume=False)
    for t, frame in enumerate(frames):
        record = FrameRecord(t, "frame" if t else "first", 40, 0, 30.0, None, None, None, None, 0.0)
        model.commit(TrainedFrame(frame, record))
    pictures = pictures_for(scene, settings)
    usage = group_usage(model.read, pictures, CPU, (0, 4))
    steps = codec_steps(frames[2], [view.camera for view in pictures.train(2)])["means"][0].numpy()
    seen = max(measure_contribution(g, view.camera).peak[0] for view in pictures.train(0))
    assert usage.moved[0] == pytest.approx(seen * 0.2 / steps[0], rel=1e-5)
    assert (usage.moved[1:] == 0).all()
