"""Write manifests/valid/<name>/, small whole packages.

    python -m tests.makers.conformance

Encoder bytes may change from one x264 to the next; what the packages decode to is pinned in tests/golden. The cases of
manifests/invalid are made of these packages: `tests.makers.refusals`.
"""

from __future__ import annotations

import shutil
import tempfile
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from airgs_codec.encoder.tables import add_sound
from tests import faces
from tests.faces import INTER, Folder, Gaussians, Manifest, Package, Place, open_package, write_tables
from tests.makers.golden import COARSE, WHOLE, encode_bare
from tests.support.chirps import write_wav
from tests.support.paths import VALID
from tests.support.scenes import room_frames


def frames(count: int, degree: int, length: int) -> list[Gaussians]:
    rng = np.random.default_rng(7)
    rest = rng.normal(size=(count, {0: 0, 1: 3}[degree], 3)) * 0.2
    still = rng.normal(size=(count, 3)) * 0.4
    columns = [rng.normal(size=(count, 4)), rng.normal(size=(count, 3)) * 0.3 - 2, rng.normal(size=count) * 2]
    columns += [rng.normal(size=(count, 3)), rest]
    swing = (np.arange(count) % 2)[:, None] * np.array([0.2, 0.05, 0.0])
    moved = [still + swing * np.sin(2.0 * t) for t in range(length)]
    return [Gaussians(*(np.asarray(c, np.float32) for c in (means, *columns))) for means in moved]


def drifting(count: int, length: int) -> list[Gaussians]:
    """The same ball, of which every row goes its own way evenly, some far."""
    rng, (first, *_) = np.random.default_rng(8), frames(count, 0, 1)
    way = rng.normal(size=(count, 3)) * np.where(np.arange(count) % 9, 0.02, 0.4)[:, None]
    return [replace(first, means=(first.means + t * way).astype(np.float32)) for t in range(length)]


BALL = faces.Region("file", 32, 24, 50.0, 0.01, 5.0, [Place([0.0, 0.0, -3.0], [0.0, 0.0, 0.0], [0.0, -1.0, 0.0], 0.2)])

ONE_KEYFRAME = replace(WHOLE, keyframe_factors=(1.0,))
KEEPING = replace(WHOLE, keyframes=INTER, group_frames=2, keep_all=True, region=BALL, measure_pictures=2)
PACKAGES = {
    "moving": (frames(64, 0, 4), COARSE),
    "inter": (room_frames(60, 6), KEEPING),
    "slopes": (drifting(80, 6), COARSE),
    "one-gaussian": (frames(1, 1, 1), ONE_KEYFRAME),
    "paged": (frames(4, 0, 65), replace(ONE_KEYFRAME, group_frames=1, tiers=(1.0,), measure_pictures=0)),
    "placed": (frames(2, 0, 1), replace(ONE_KEYFRAME, world=faces.world_from((0, 0, 1), 0.01))),
    "white": (frames(2, 0, 1), replace(ONE_KEYFRAME, region=replace(BALL, background=[1.0, 1.0, 1.0]))),
    "two-groups-sh1": (frames(40, 1, 5), replace(WHOLE, group_frames=3, segment_s=0.07)),
}


def main() -> None:
    shutil.rmtree(VALID, ignore_errors=True)
    for name, (sequence, settings) in PACKAGES.items():
        encode_bare(sequence, VALID / name, settings)
    package = open_package(VALID / "two-groups-sh1")
    m, moment = package.manifest, datetime(2026, 1, 1, tzinfo=UTC)
    # live: the first group while the second is still to come
    first = replace(m, frames=m.groups[0].stop, live=True, groups=faces.Groups.of(m.groups[:1]))
    write_tables(copied(package, first, "live"), first, faces.LiveClock(moment, moment))
    # sound: both with a tone
    tone = np.round(8000 * np.sin(2 * np.pi * 440 * np.arange(48_000) / 48_000)).astype("<i2")
    with tempfile.TemporaryDirectory() as folder:
        track = faces.encode_sound(write_wav(Path(folder) / "tone.wav", tone[:, None]), m.frames / m.fps)
    with_sound, files = add_sound(m, track)
    sound = copied(package, m, "sound")
    for path, data in files.items():
        sound.write(path, data)
    write_tables(sound, with_sound)


def copied(package: Package, m: Manifest, name: str) -> Folder:
    """A folder with the files of the groups of `m`, without tables."""
    folder = Folder(VALID / name)
    for path in (*m.shared_files(), *(path for group in range(len(m.groups)) for path in m.group_files(group))):
        folder.write(path, package.read(path))
    return folder


if __name__ == "__main__":
    main()
