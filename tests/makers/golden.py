"""Write tests/golden: small packages, and the digests of the codes they decode to.

    python -m tests.makers.golden

Run it only when the byte format changes: the digests say what every later decoder must read from these bytes.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import numpy as np

from airgs_codec.coding.steps import StepSettings
from airgs_codec.decoder.decode import decode_key, decode_state
from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import APART, KEPT, EncodeSettings, LevelSettings
from airgs_codec.package.package import Package, open_package
from airgs_codec.package.paths import tile_folder
from airgs_codec.scene.sequence import open_sequence
from tests.support.paths import FOX, GOLDEN
from tests.support.rooms import room_frames
from tests.support.scenes import write_sequence

ROWS = 700  # Gaussians kept of the embedded scene


def digest(codes: np.ndarray) -> str:
    """SHA-256 of codes as little-endian int32, row by row."""
    return sha256(np.ascontiguousarray(codes, "<i4").tobytes()).hexdigest()


def digests(package: Package) -> dict[str, str]:
    """Digest of the codes of every key unit and every frame of every state segment."""
    m = package.manifest
    out = {}
    for g, group in enumerate(m.groups):
        for k, unit in enumerate(group.units):
            name = f"group {g} {tile_folder(k // m.tiers, m.tiles)}T{k % m.tiers}"
            for q in range(len(m.qualities) if unit.count else 0):
                codes, sidecar = decode_key(package, g, k, q)
                out[f"{name} Q{q}"] = digest(codes)
                out[f"{name} Q{q} means"] = sha256(sidecar.codes.astype("<u8").tobytes()).hexdigest()
                out[f"{name} depths"] = sha256(sidecar.depths.tobytes()).hexdigest()
                if unit.kept:
                    kept = sidecar.kept
                    out[f"{name} kept"] = sha256(kept.rows.astype("<u4").tobytes()).hexdigest()
                    out[f"{name} kept depths"] = sha256(kept.depths.tobytes()).hexdigest()
    for s, segment in enumerate(m.segments):
        for j, p in np.ndindex(len(m.levels), m.tiles):
            if m.state_files(s, j, [p]):
                for f, codes in enumerate(decode_state(package, s, j, 0, segment.stop - segment.start, p)):
                    out[f"segment {s} {tile_folder(p, m.tiles)}L{j} frame {f}"] = digest(codes)
    return out


def main() -> None:
    """Write the corpus anew."""
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
        "tiles": (room_frames(ROWS // 2, 4, degree=1), replace(coarse, keys=KEPT, keep_all=True, tiles=3)),
    }
    for name, (cut, settings) in cases.items():
        with tempfile.TemporaryDirectory() as folder:
            scene = write_sequence(Path(folder), cut, fps=24, keyframes=[0, 2])
            encode(open_sequence(scene), GOLDEN / name, settings)
        table = json.dumps(digests(open_package(GOLDEN / name)), indent=1)
        (GOLDEN / f"{name}.json").write_text(table + "\n")


if __name__ == "__main__":
    main()
