"""The rules of a player: how much it buffers, when it begins, what it may do beside fetching segment after segment."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from airgs_codec.errors import ConfigError


@dataclass(frozen=True, slots=True)
class SessionSettings:
    """Rules of the player, with the command line's help. Raises ConfigError for rules that cannot work."""

    buffer_s: float = field(default=10.0, metadata={"help": "most media time ahead of the playhead"})
    startup_s: float = field(
        default=1.0, metadata={"help": "media time to buffer before playing begins, one segment at least"}
    )
    resume_s: float = field(default=0.5, metadata={"help": "the same before playing goes on after a stall"})
    decode_frame_s: float = field(default=0.004, metadata={"help": "time to decode and apply one frame"})
    replace: bool = field(default=True, metadata={"help": "fetch better rungs for segments that are buffered"})
    abandon: bool = field(default=True, metadata={"help": "give up a download that would come too late"})
    pipelined: bool = field(
        default=True,
        metadata={"help": "request a segment one round trip before the current batch ends, knowing one download less"},
    )
    loops: int | None = field(
        default=None, metadata={"help": "times the sequence is played (default: about 30 s of play)"}
    )

    def __post_init__(self) -> None:
        if not 0 < self.buffer_s < math.inf:
            raise ConfigError(f"buffer: expected more than 0 s, got {self.buffer_s:g}")
        for name, value in (("start-up", self.startup_s), ("resume", self.resume_s)):
            if not 0 <= value < math.inf:
                raise ConfigError(f"{name}: expected 0 s or more, got {value:g}")
        if not 0 <= self.decode_frame_s < math.inf:
            raise ConfigError(f"decoding: expected 0 s a frame or more, got {self.decode_frame_s:g}")
        if self.loops is not None and self.loops < 1:
            raise ConfigError(f"loops: expected at least 1, got {self.loops}")
