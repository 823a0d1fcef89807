"""A sample of one group, and what coding it costs. T frames, n rows, c channels, C colour channels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec.analysis.sensitivity import Sensitivity
from airgs_codec.coding.channels import Canonical, dequantise_key, key_channels, state_channels
from airgs_codec.coding.colour import colour_transform
from airgs_codec.coding.grid import fit_grid, grid_codes
from airgs_codec.coding.roundtrip import encode_and_decode
from airgs_codec.coding.sidecar import KeySidecar, pack_key_sidecar
from airgs_codec.coding.steps import StepSettings, world_steps
from airgs_codec.coding.weights import channel_weights, withheld_error
from airgs_codec.media.h264 import key_codec, state_codec
from airgs_codec.package import tables
from airgs_codec.package.layout import KEY, STATE
from airgs_codec.package.tables import KeySteps
from airgs_codec.scene.gaussians import Gaussians

BLOCK_ROWS = 256
PRESET = "fast"
KEY_PARTS = {"log_scales": slice(0, 3), "quaternions": slice(3, 6), "opacity": slice(6, 7), "colour": slice(7, None)}
STATE_PARTS = {
    "means": slice(0, 3),
    "log_scales": slice(3, 6),
    "quaternions": slice(6, 9),
    "opacity": slice(9, 10),
    "colour": slice(10, None),
}
ALL = tuple(STATE_PARTS)


@dataclass(frozen=True, slots=True)
class Cost:
    """Bytes a frame of the group, and mean squared error over picture samples."""

    bytes: float
    key_error: float  # of rows that show the canonical frame
    state_error: float  # of rows that are updated


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """Blocks of rows of a group in file order, over some of its frames."""

    index: NDArray[np.intp]  # (n,) rows of the group in file order
    key: Gaussians  # n rows of the canonical frame
    frames: list[Gaussians]  # T, one after the other
    classes: NDArray[np.int16]  # (n,)
    sensitivity: Sensitivity  # (n,)
    moving: NDArray[np.bool_]  # (n,) rows that some level carries
    scale: float  # rows of the group for each of the sample
    group: int  # frames of the group
    segment: int  # frames of a state segment

    def take(self, rows: NDArray[np.bool_]) -> Sample:
        """Fewer rows, as a sample of a group that has fewer by the same share."""
        return replace(
            self,
            index=self.index[rows],
            key=self.key.take(rows),
            frames=[frame.take(rows) for frame in self.frames],
            classes=self.classes[rows],
            sensitivity=self.sensitivity.take(np.flatnonzero(rows)),
            moving=self.moving[rows],
        )

    def cost(self, steps: StepSettings, parts: Sequence[str] = ALL) -> Cost:
        """Of coding these attributes, keys and states, at `steps`."""
        size, errors = 0.0, np.zeros(len(self.classes))
        for part in parts:
            key_bytes, base = self.code_key(steps, 1.0, (part,))
            states = self.states(base, steps)
            state_bytes, shown = self.code_states(states, 1.0, STATE_PARTS[part])
            size += key_bytes + state_bytes
            errors += self.error(shown, steps)
        return Cost(size, float(errors[~self.moving].sum()), float(errors[self.moving].sum()))

    def code_key(self, steps: StepSettings, factor: float, parts: Sequence[str] = ALL) -> tuple[float, Canonical]:
        """Bytes a frame, and the canonical space as decoded; attributes that are not in `parts` stay exact."""
        key_steps, _, cell = world_steps(steps, 1.0)
        key = self.key
        colours = 3 * (1 + key.sh_rest.shape[1])
        transform = self._transform(key_steps)
        values = key_channels(key, transform, key_steps)
        channels = values.astype(np.float32)
        chosen = np.zeros(len(values), bool)
        for part in parts:
            if part in KEY_PARTS:
                chosen[KEY_PARTS[part]] = True
        size = 0.0
        if chosen.any():
            step = KEY.steps(key_steps, colours)[chosen] * factor
            codec = key_codec(PRESET)
            sizes, decoded = encode_and_decode(values[None, chosen], step, codec)
            channels[chosen] = decoded[0]
            size += sizes[0]
        grid = fit_grid(key.means, self.classes, cell)
        codes = grid_codes(key.means, self.classes, grid)
        if "means" in parts:
            order = np.argsort(codes, kind="stable")
            still = np.zeros(len(codes), np.uint8)
            size += len(pack_key_sidecar(KeySidecar(codes[order], self.classes[order], still), grid))
        base = dequantise_key(channels, codes, self.classes, np.zeros(len(codes), np.uint8), transform, grid, key_steps)
        return self.scale * size / self.group, base

    def error(self, errors: NDArray[np.float64], steps: StepSettings) -> NDArray[np.float64]:
        """(n,) what errors (T, 10 + C, n), in steps, add to the mean squared error of pictures of the whole group."""
        key_steps, state_steps, _ = world_steps(steps, 1.0)
        transform = self._transform(key_steps)
        return self.scale * withheld_error(
            errors, channel_weights(self.classes, self.sensitivity, state_steps, transform)
        )

    def _transform(self, steps: KeySteps) -> NDArray[np.float64]:
        key = self.key
        return tables.unpack_matrix(colour_transform(key, steps), 3 * (1 + key.sh_rest.shape[1]))

    def states(self, base: Canonical, steps: StepSettings) -> NDArray[np.float64]:
        """(1 + T, 10 + C, n) differences of the canonical frame and the others to a canonical space, in steps."""
        _, state_steps, _ = world_steps(steps, 1.0)
        values = state_channels([self.key, *self.frames], base, state_steps)
        return values / STATE.steps(state_steps, base.colours.shape[1])[:, None]

    def code_states(
        self, states: NDArray[np.float64], factor: float, part: slice = slice(None)
    ) -> tuple[float, NDArray[np.float64]]:
        """Bytes a frame of moving rows, and (T, 10 + C, n) errors in steps of what is shown, in the channels `part`.

        `states` are those of `self.states`. A row that is not moving has the error of its canonical frame.
        """
        errors = np.zeros_like(states[1:])
        channels = np.arange(states.shape[1])[part]
        still, moving = np.flatnonzero(~self.moving), np.flatnonzero(self.moving)
        errors[:, channels[:, None], still] = states[0][channels[:, None], still]
        if not len(moving):
            return 0.0, errors
        values = states[1:, channels[:, None], moving]
        codec = state_codec(PRESET)
        sizes, decoded = encode_and_decode(values, np.full(len(channels), factor), codec)
        errors[:, channels[:, None], moving] = decoded - values
        others = float(np.mean(sizes[1:])) if len(sizes) > 1 else 0.0
        return self.scale * (sizes[0] + (self.segment - 1) * others) / self.segment, errors
