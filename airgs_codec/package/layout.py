"""The channels of key and state atlases: the one place that knows their order, steps and units (FORMAT.md, section 5).

C colour channels. A channel is one scalar of an attribute and, where it varies, one plane of an atlas. The channels of
an attribute follow each other; colour comes last, since only its width depends on the scene.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airgs_codec.package.tables import KeySteps, StateSteps

COLOUR = "colour"


@dataclass(frozen=True, slots=True)
class ChannelRun:
    """The channels of one attribute of fixed width."""

    attribute: str  # the field of KeySteps or StateSteps that holds its quantiser step
    axes: tuple[str, ...]  # one name a channel
    unit: str  # of a channel, and so of its step


@dataclass(frozen=True, slots=True)
class Layout:
    """The channels of a kind of atlas, in order: those of `runs`, then C of colour."""

    kind: str  # "key" or "state"
    runs: tuple[ChannelRun, ...]

    @property
    def attributes(self) -> tuple[str, ...]:
        """Attributes in channel order, colour last: the order of `Atlas.max_error`."""
        return (*(run.attribute for run in self.runs), COLOUR)

    @property
    def colour_start(self) -> int:
        """Index of the first colour channel."""
        return sum(len(run.axes) for run in self.runs)

    def width(self, colours: int) -> int:
        """Channels in all, of which `colours` are of colour."""
        return self.colour_start + colours

    def slice(self, attribute: str) -> slice:
        """Where the channels of an attribute are. Raises KeyError for an attribute this kind of atlas has not."""
        start = 0
        for run in self.runs:
            if run.attribute == attribute:
                return slice(start, start + len(run.axes))
            start += len(run.axes)
        if attribute != COLOUR:
            raise KeyError(attribute)
        return slice(start, None)

    def attribute_index(self, channels: int) -> NDArray[np.intp]:
        """(channels,) place of each channel's attribute in `attributes`."""
        widths = [len(run.axes) for run in self.runs]
        return np.repeat(np.arange(len(widths) + 1), [*widths, channels - sum(widths)])

    def attribute_of(self, channel: int) -> str:
        """The attribute that a channel belongs to."""
        return self.attributes[int(self.attribute_index(max(channel + 1, self.colour_start))[channel])]

    def steps(self, steps: KeySteps | StateSteps, colours: int) -> NDArray[np.float64]:
        """(channels,) quantiser step of each channel at factor 1; colour channels count in steps already."""
        fixed = [getattr(steps, run.attribute) for run in self.runs for _ in run.axes]
        return np.array(fixed + [1.0] * colours)


_XYZ = ("x", "y", "z")
KEY = Layout(
    "key",
    (
        ChannelRun("log_scales", _XYZ, "ln(world units)"),
        ChannelRun("quaternions", _XYZ, "radians"),
        ChannelRun("opacity", ("alpha",), "of [0, 1]"),
    ),
)
STATE = Layout("state", (ChannelRun("means", _XYZ, "motion units"), *KEY.runs))
