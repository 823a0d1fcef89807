"""One error tree; each error is also the matching builtin, so callers may catch either."""

from __future__ import annotations


class AirgsError(Exception):
    """Everything this package raises on purpose. A command prints it as one line and exits with 2.

    + SceneError (ValueError)       a scene we cannot code: no frames, no Gaussians, broken .ply
    + ConfigError (ValueError)      settings that cannot work
    + FormatError (ValueError)      a manifest or a file of a package we refuse; has .reason and .where
    + TrainingError (RuntimeError)  a fit went wrong: its loss is not finite
    + CodecError (RuntimeError)     FFmpeg refused, or decoded something else than it encoded
    + TransportError (OSError)      a segment did not arrive, a trace cannot be used
    """


class SceneError(AirgsError, ValueError):
    """A scene that cannot be coded."""


class ConfigError(AirgsError, ValueError):
    """Settings that cannot work."""


class FormatError(AirgsError, ValueError):
    """A package that is refused.

    `reason` is a word from FORMAT.md's table of refusals, `where` the file and the place in it.
    """

    def __init__(self, reason: str, where: str, detail: str) -> None:
        super().__init__(f"{where}: {detail} [{reason}]")
        self.reason = reason
        self.where = where
        self.detail = detail


class TrainingError(AirgsError, RuntimeError):
    """A fit that went wrong: its loss is not finite."""


class CodecError(AirgsError, RuntimeError):
    """The video codec refused, or its decoder gave something else than its encoder promised."""


class TransportError(AirgsError, OSError):
    """Something did not arrive, or a trace cannot carry it."""
