"""What a viewer would find wrong with the files of a package, and how fast this machine decodes it."""

from __future__ import annotations

import time

from airgs_codec.decoder.decode import decode_canonical, decode_segment
from airgs_codec.errors import FormatError
from airgs_codec.package.store import Package
from airgs_codec.play.player import MISSING


def find_faults(package: Package) -> dict[str, str]:
    """Files that are not there ("missing") or not what airgs.json says, with what is wrong."""
    faults: dict[str, str] = {}
    for path in package.manifest.files:
        try:
            package.read(path)
        except FormatError as error:
            faults[path] = MISSING if error.reason == "missing_file" else f"{error.detail}"
    return faults


def measure_decoding(package: Package) -> float:
    """Seconds a frame that this machine takes to decode the package once at its top rung, keys included."""
    m = package.manifest
    began = time.perf_counter()
    group = -1
    for index, segment in enumerate(m.segments):
        if segment.group != group:
            group, base = segment.group, decode_canonical(package, segment.group, 0)
        for _ in decode_segment(package, index, base, 0, 0, segment.stop - segment.start):
            pass
    return (time.perf_counter() - began) / m.frames
