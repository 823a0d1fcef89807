"""Write tests/golden: small packages, and the digests of the codes they decode to.

    python -m tests.makers.golden

Run it only when the byte format changes: the digests say what every later decoder must read from these bytes.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from tests import faces
from tests.faces import INTER, INTRA, EncodeSettings, Folder, LevelSettings, StepSettings, open_package, open_sequence
from tests.support.digests import digests
from tests.support.paths import FOX, GOLDEN
from tests.support.scenes import room_frames, write_sequence

ROWS = 700  # Gaussians kept of the embedded scene
WHOLE = EncodeSettings(calibrate="none", levels=(LevelSettings(0.0),), keyframes=INTRA)
COARSE = replace(WHOLE, levels=(LevelSettings(0.0), LevelSettings(0.5, 2.0, quality=1)))  # and a level of half the rows


def encode_bare(frames: Sequence[faces.Gaussians], place: Path, settings: EncodeSettings, **sequence: object) -> None:
    """Encode frames without cameras, and without a poster; `sequence` are entries of sequence.json."""
    with tempfile.TemporaryDirectory() as folder:
        scene = write_sequence(Path(folder), list(frames), cameras=False, **sequence)
        faces.encode(open_sequence(scene), place, settings)
    faces.write_tables(Folder(place), replace(open_package(place).manifest, poster=None))
    (place / faces.POSTER_NAME).unlink()


def main() -> None:
    shutil.rmtree(GOLDEN, ignore_errors=True)
    GOLDEN.mkdir()
    source = open_sequence(FOX)
    rows = np.linspace(0, 4999, ROWS).astype(int)
    fox = {frame: source.read(frame).take(rows) for frame in range(3, 8)}
    fine = replace(WHOLE, keyframe_factors=(1.0,), quality=0.1, steps=StepSettings(grid=0.00007))
    cases = {
        "fox": ([fox[frame] for frame in range(3, 7)], COARSE),
        "fox-fine": ([fox[frame] for frame in range(5, 8)], fine),
        "room": (room_frames(ROWS, 4, degree=1), replace(COARSE, keyframes=INTER, keep_all=True)),
    }
    for name, (cut, settings) in cases.items():
        encode_bare(cut, GOLDEN / name, settings, fps=24, keyframes=[0, 2])
        table = json.dumps(digests(open_package(GOLDEN / name)), indent=1)
        (GOLDEN / f"{name}.json").write_text(table + "\n")


if __name__ == "__main__":
    main()
