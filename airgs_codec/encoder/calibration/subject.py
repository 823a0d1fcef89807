"""The group that a scene is calibrated on, and the sample of it that trial encodes code.

N rows of the group, n rows of the sample.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec._sampling import evenly_spaced
from airgs_codec.analysis.importance import RowPruning
from airgs_codec.coding.weights import channel_weights
from airgs_codec.encoder.calibration.sample import BLOCK_ROWS, CalibrationSample
from airgs_codec.encoder.plan import GroupLayout, keep_rows, lay_out, prune_rows
from airgs_codec.encoder.rank import find_moving
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.encoder.survey import Survey
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.sequence import GaussianSequence

SAMPLE_BLOCKS = 150  # of rows, over all frames of the sample together
FEWEST_BLOCKS = 5  # in a frame
MOST_FRAMES = 32


@dataclass(frozen=True, slots=True, eq=False)
class Subject:
    """The group that is calibrated on."""

    frames: Sequence[Gaussians]  # all of the group, with all input rows
    layout: GroupLayout
    pruning: RowPruning
    settings: EncodeSettings

    @staticmethod
    def of(sequence: GaussianSequence, survey: Survey, settings: EncodeSettings) -> Subject:
        """Lay out the group at `settings`."""
        loaded = sequence.load(range(survey.span.start, survey.span.stop))
        layout = lay_out(loaded, survey, keep_rows(loaded.frames, survey, settings), settings, sequence.fps)
        return Subject(loaded.frames, layout, prune_rows(loaded.frames, survey), settings)

    def canonical(self) -> Gaussians:
        """The canonical frame, N rows in file order."""
        return self.layout.key

    def sample(self, fps: float) -> CalibrationSample:
        """Blocks spread over all rows, and the frames of the first segment: enough to see P and B pictures settle."""
        layout, settings = self.layout, self.settings
        segment = min(len(self.frames), MOST_FRAMES, max(1, int(settings.segment_s * fps)))
        index = block_rows(len(layout.rows), max(FEWEST_BLOCKS, SAMPLE_BLOCKS // segment))
        sample = CalibrationSample(
            index=index,
            key=layout.key.take(index),
            frames=[frame.take(layout.rows[index]) for frame in self.frames[:segment]],
            classes=layout.classes[index],
            sensitivity=layout.sensitivity.take(index),
            moving=np.ones(len(index), bool),
            row_ratio=len(layout.rows) / len(index),
            group_frames=len(self.frames),
            segment_frames=segment,
        )
        states = sample.states(sample.code_key(settings.steps, 1.0)[1], settings.steps)
        weights = channel_weights(sample.classes, sample.sensitivity, layout.state_steps, layout.transform)
        moving = find_moving(states[1:], states[1:] - states[0], weights, settings.keep_all)
        return replace(sample, moving=moving)


def block_rows(rows: int, most: int) -> NDArray[np.intp]:
    """(n,) rows of at most `most` evenly spaced blocks of BLOCK_ROWS."""
    blocks = np.array(evenly_spaced(-(-rows // BLOCK_ROWS), most))
    index = (blocks[:, None] * BLOCK_ROWS + np.arange(BLOCK_ROWS)).ravel()
    return index[index < rows]
