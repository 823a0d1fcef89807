"""Write tests/golden: small packages, and the digests of the codes they decode to.

    python -m tests.makers.golden

Run it only when the byte format changes: the digests say what every later decoder must read from these bytes.
"""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import numpy as np

from tests.faces import APART, KEPT, EncodeSettings, LevelSettings, StepSettings, open_package, open_sequence
from tests.makers.bare import encode_bare
from tests.support.digests import digests
from tests.support.paths import FOX, GOLDEN
from tests.support.rooms import room_frames

ROWS = 700  # Gaussians kept of the embedded scene


def main() -> None:
    shutil.rmtree(GOLDEN, ignore_errors=True)
    GOLDEN.mkdir()
    source = open_sequence(FOX)
    rows = np.linspace(0, 4999, ROWS).astype(int)
    fox = {frame: source.read(frame).take(rows) for frame in range(3, 8)}
    fine = StepSettings(grid=0.00007)
    coarse = EncodeSettings(
        calibrate="none", levels=(LevelSettings(0.0), LevelSettings(0.5, 2.0, quality=1)), keys=APART
    )
    cases = {
        "fox": ([fox[frame] for frame in range(3, 7)], coarse),
        "fox-fine": (
            [fox[frame] for frame in range(5, 8)],
            replace(coarse, levels=(LevelSettings(0.0),), key_factors=(1.0,), quality=0.1, steps=fine),
        ),
        "room": (room_frames(ROWS, 4, degree=1), replace(coarse, keys=KEPT, keep_all=True)),
    }
    for name, (cut, settings) in cases.items():
        encode_bare(cut, GOLDEN / name, settings, fps=24, keyframes=[0, 2])
        table = json.dumps(digests(open_package(GOLDEN / name)), indent=1)
        (GOLDEN / f"{name}.json").write_text(table + "\n")


if __name__ == "__main__":
    main()
