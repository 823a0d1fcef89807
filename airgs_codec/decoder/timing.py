"""How fast this machine decodes a package, for players that must know when a frame is ready."""

from __future__ import annotations

import time

from airgs_codec.decoder.decode import decode_canonical, decode_segment
from airgs_codec.package.package import Package


def measure_decoding(package: Package) -> float:
    """Seconds a frame that this machine takes to decode the package once at its top rung, keys included."""
    m = package.manifest
    began = time.perf_counter()
    group = -1
    for index, segment in enumerate(m.segments):
        if m.group_of(index) != group:
            group = m.group_of(index)
            base = decode_canonical(package, group, 0)
        for _ in decode_segment(package, index, base, 0, range(segment.stop - segment.start)):
            pass
    return (time.perf_counter() - began) / m.frames
