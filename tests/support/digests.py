"""What a package decodes to, as digests: integer codes, rows and depths."""

from __future__ import annotations

from hashlib import sha256

import numpy as np

from airgs_codec.decoder.decode import decode_key
from airgs_codec.decoder.states import decode_pictures, decode_slopes
from airgs_codec.package.layout import tile_folder
from airgs_codec.package.manifest import Manifest
from airgs_codec.package.package import Package


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
    for s, segment in enumerate(m.segments):
        for j, p in np.ndindex(len(m.levels), m.tiles):
            if m.state_files(s, j, [p]):
                name = f"segment {s} {tile_folder(p, m.tiles)}L{j}"
                slopes = decode_slopes(package, s, j, p)
                if slopes is not None:
                    out[f"{name} slopes"] = digest(slopes)
                for f, shown in enumerate(decode_pictures(package, s, j, range(segment.stop - segment.start), p)):
                    out[f"{name} frame {f}"] = digest(shown.codes())
    return out


def lined_files(m: Manifest) -> list[str]:
    """Paths of the state files that begin with a picture of slopes, which is no frame."""
    return [
        path
        for s, segment in enumerate(m.segments)
        for j, level in enumerate(segment.levels)
        for path in m.state_files(s, j, [tile for tile in range(m.tiles) if level.lined(tile)])
    ]
