"""Packages of a corpus: small, so without a poster."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from tests.faces import (
    POSTER_NAME,
    EncodeSettings,
    Folder,
    Gaussians,
    encode,
    open_package,
    open_sequence,
    write_tables,
)
from tests.support.scenes import write_sequence


def encode_bare(frames: Sequence[Gaussians], place: Path, settings: EncodeSettings, **sequence: object) -> None:
    """Encode frames without cameras; `sequence` are entries of sequence.json."""
    with tempfile.TemporaryDirectory() as folder:
        scene = write_sequence(Path(folder), list(frames), cameras=False, **sequence)
        encode(open_sequence(scene), place, settings)
    write_tables(Folder(place), replace(open_package(place).manifest, poster=None))
    (place / POSTER_NAME).unlink()
