"""The rules of a player: how much it buffers, when it begins, what it may do beside fetching segment after segment."""

from __future__ import annotations

import math
from dataclasses import dataclass

from airgs_codec._settings import documented, setting
from airgs_codec.errors import ConfigError

LEAST_S = 1e-3  # of a buffer: no frame is shorter


@documented
@dataclass(frozen=True, slots=True)
class SessionSettings:
    """Rules of the player. Raises ConfigError for rules that cannot work."""

    buffer_s: float = setting(10.0, "most media time ahead of the playhead, in seconds")
    startup_s: float = setting(1.0, "media time in seconds to buffer before playing begins, one segment at least")
    resume_s: float = setting(0.5, "media time in seconds to buffer before playing goes on after a stall")
    decode_frame_s: float = setting(0.004, "time to decode and apply one frame")
    replace: bool = setting(True, "fetch better rungs for segments that are buffered")
    abandon: bool = setting(True, "give up a download that would come too late")
    pipelined: bool = setting(
        True, "request a segment one round trip before the current batch ends, knowing one download less"
    )
    loops: int | None = setting(None, "times the sequence is played; by default about 30 s of play")
    budget: int | None = setting(None, "most Gaussians that are fetched and shown of a group; by default any number")

    def __post_init__(self) -> None:
        if not LEAST_S <= self.buffer_s < math.inf:
            raise ConfigError(f"buffer: expected {LEAST_S:g} s or more, got {self.buffer_s:g}")
        for name, value in (("start-up", self.startup_s), ("resume", self.resume_s)):
            if not 0 <= value < math.inf:
                raise ConfigError(f"{name}: expected 0 s or more, got {value:g}")
        if not 0 <= self.decode_frame_s < math.inf:
            raise ConfigError(f"decoding: expected 0 s a frame or more, got {self.decode_frame_s:g}")
        if self.budget is not None and self.budget < 1:
            raise ConfigError(f"budget: expected at least 1 Gaussian, got {self.budget}")
        if self.loops is not None and self.loops < 1:
            raise ConfigError(f"loops: expected at least 1, got {self.loops}")
