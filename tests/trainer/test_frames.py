"""Usage of a trained model."""

import numpy as np
import pytest

from airgs_codec.analysis.grouping import plan_groups
from airgs_codec.encoder.survey import GroupSpan, ViewPlan, survey_group
from airgs_codec.errors import SceneError
from airgs_codec.scene.beside import load_usage
from airgs_codec.scene.sequence import open_sequence
from tests.support.views import measure_usage


def test_usage_is_of_all_frames_and_the_encoder_takes_it(run):
    sequence = open_sequence(run.folder)
    training = [c for c in sequence.cameras if c.split == "train"]
    (start, stop) = plan_groups(sequence).spans[0]
    saved = sequence.usage(start, stop)
    measured = measure_usage([sequence.read(t) for t in range(start, stop)], training)
    np.testing.assert_allclose(saved.total, measured.total)
    np.testing.assert_array_equal(saved.hits, measured.hits)
    survey = survey_group(sequence, GroupSpan(0, start, stop), ViewPlan.of(sequence, 24))
    assert survey.usage.total.tolist() == saved.total.tolist()
    assert sequence.usage(0, 2) is None  # another group: measured anew


def test_usage_that_is_broken_is_refused(run, tmp_path):
    path = tmp_path / "usage.npz"
    path.write_bytes(b"PK\x03\x04 broken")
    with pytest.raises(SceneError, match=r"usage\.npz: expected usage"):
        load_usage(path, 0, 3, 10)
