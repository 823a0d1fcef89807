"""The tree of errors. Each is also the matching builtin, so that callers may catch either."""

from __future__ import annotations

import copyreg
from typing import Any


class AirgsError(Exception):
    """Everything this package raises on purpose; its text is one line that says where, what was expected, what came.

    A command prints it and exits with status 2. Errors can be pickled, whatever their constructors take, so that they
    come whole from worker processes.
    """

    def __reduce__(self) -> tuple[Any, ...]:
        return copyreg.__newobj__, (type(self), *self.args), self.__dict__  # type: ignore[attr-defined]


class SceneError(AirgsError, ValueError):
    """A scene, or something that belongs to it, that cannot be used: no frames, a broken .ply, cameras, usage."""


class ConfigError(AirgsError, ValueError):
    """Settings that cannot work, or a file in the way of what should be written."""


class FrameError(ConfigError, IndexError):
    """A frame that a sequence or a package does not have."""


class FormatError(AirgsError, ValueError):
    """A package that is refused.

    `reason` is a word from FORMAT.md's table of refusals, `where` the file and the place in it.
    """

    def __init__(self, reason: str, where: str, detail: str) -> None:
        super().__init__(f"{where}: {detail} [{reason}]")
        self.reason, self.where, self.detail = reason, where, detail


class TrainingError(AirgsError, RuntimeError):
    """A fit that went wrong: its loss is not finite, or no Gaussian is left."""


class CodecError(AirgsError, RuntimeError):
    """The video codec refused, or its decoder gave something else than its encoder promised."""


class TransportError(AirgsError, OSError):
    """A segment did not arrive, an object store refused, or a trace of a link cannot be used."""


class WorkError(AirgsError, RuntimeError):
    """Jobs could not be finished: their workers died again and again, or what one reads is gone."""
