"""The packages that tests share, by name: each is encoded once in a run, by a function of its folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from tests.faces import EncodeSettings, encode, open_sequence
from tests.support.paths import FOX


def fox(folder: Path) -> None:
    """The embedded scene, measured, without calibration."""
    settings = EncodeSettings(calibrate="none", measure_pictures=8, preset="veryfast", threads=2)
    encode(open_sequence(FOX), folder, settings)


PACKAGES: dict[str, Callable[[Path], object]] = {"fox": fox}
