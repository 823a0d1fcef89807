"""Packages of a corpus: small, so without a poster."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.package.layout import POSTER_NAME
from airgs_codec.package.package import open_package
from airgs_codec.package.publish import write_tables
from airgs_codec.places.place import Folder
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.sequence import open_sequence
from tests.support.scenes import write_sequence


def encode_bare(frames: Sequence[Gaussians], place: Path, settings: EncodeSettings, **sequence: object) -> None:
    """Encode frames without cameras; `sequence` are entries of sequence.json."""
    with tempfile.TemporaryDirectory() as folder:
        scene = write_sequence(Path(folder), list(frames), cameras=False, **sequence)
        encode(open_sequence(scene), place, settings)
    write_tables(Folder(place), replace(open_package(place).manifest, poster=None))
    (place / POSTER_NAME).unlink()
