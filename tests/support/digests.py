"""What a package decodes to, as digests: integer codes, rows and depths.

A decoder needs no library but numpy and av, and so does this: the faces of all tests are not loaded.
"""

from __future__ import annotations

from dataclasses import replace
from hashlib import sha256
from typing import TYPE_CHECKING, Any

import numpy as np

from airgs_codec.coding.atlas import read_codes
from airgs_codec.decoder.decode import decode_pictures, read_keyframe

if TYPE_CHECKING:
    from tests.faces import Manifest, Package


def decode_slopes(package: Package, index: int, level: int) -> np.ndarray | None:
    """(10 + C, n) codes of the slopes of a segment with a file, None where it has none."""
    shown = next(decode_pictures(package, index, level, range(1)))
    atlas = replace(shown.atlas, centres=[0] * len(shown.atlas.centres))
    return None if shown.slopes is None else read_codes(shown.slopes[0], atlas, shown.slopes[1])


def decode_keyframe(package: Package, group: int, tier: int, quality: int) -> tuple[np.ndarray, Any]:
    """Codes (c, n) of a keyframe tier, n = 0 without a picture, and its sidecar."""
    shown, sidecar = read_keyframe(package, group, tier, quality)
    atlas = package.manifest.groups[group].tiers[tier].qualities[quality]
    return shown.codes() if shown else np.empty((len(atlas.centres), 0), np.int32), sidecar


def digest(codes: np.ndarray) -> str:
    return sha256(np.ascontiguousarray(codes, "<i4").tobytes()).hexdigest()


def digests(package: Package) -> dict[str, str]:
    """Digest of the codes of every keyframe tier and every frame of every delta segment."""
    m = package.manifest
    out = {}
    for g, group in enumerate(m.groups):
        for t, tier in enumerate(group.tiers):
            name = f"group {g} T{t}"
            for q in range(len(m.qualities) if tier.count else 0):
                codes, sidecar = decode_keyframe(package, g, t, q)
                out[f"{name} Q{q}"] = digest(codes)
                out[f"{name} Q{q} means"] = sha256(sidecar.codes.astype("<u8").tobytes()).hexdigest()
                out[f"{name} depths"] = sha256(sidecar.depths.tobytes()).hexdigest()
    for s, segment in enumerate(m.segments):
        for j in range(len(m.levels)):
            if m.delta_files(s, j):
                name = f"segment {s} L{j}"
                slopes = decode_slopes(package, s, j)
                if slopes is not None:
                    out[f"{name} slopes"] = digest(slopes)
                for f, shown in enumerate(decode_pictures(package, s, j, range(segment.stop - segment.start))):
                    out[f"{name} frame {f}"] = digest(shown.codes())
    return out


def sloped_files(m: Manifest) -> list[str]:
    """Paths of the delta files that begin with a picture of slopes, which is no frame."""
    levels = ((s, j, level) for s, segment in enumerate(m.segments) for j, level in enumerate(segment.levels))
    return [path for s, j, level in levels if level.slopes for path in m.delta_files(s, j)]
