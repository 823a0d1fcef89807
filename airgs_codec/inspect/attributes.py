"""Which attributes the bytes of the top rung go to: an estimate by entropy. P planes of an atlas, N rows."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding.atlas import extract
from airgs_codec.media.h264 import decode_pictures, open_segment
from airgs_codec.package.layout import KEY, STATE, Layout
from airgs_codec.package.package import Package
from airgs_codec.package.tables import Atlas


def bytes_by_attribute(package: Package) -> dict[str, float]:
    """Bytes of the top rung (all key tiers in Q0, and L0) by attribute, the largest first.

    H.264 codes an atlas as a whole, so its bytes are shared out by zero-order entropy: of the samples in key pictures,
    of their change from picture to picture in state segments. Key sidecars are canonical means, and so are the 3 bits a
    row that Q0 adds for every power of 2 by which its cells are finer than the coarsest. Raises FormatError.
    """
    out = dict.fromkeys(STATE.attributes, 0.0)
    for attribute, size in (*_of_keys(package), *_of_states(package)):
        out[attribute] += size
    return dict(sorted(out.items(), key=lambda item: -item[1]))


def format_attributes(package: Package) -> str:
    """`bytes_by_attribute` as one line."""
    frames = package.manifest.frames
    parts = [f"{name} {size / frames / 1e3:.2f}" for name, size in bytes_by_attribute(package).items()]
    return f"top rung by attribute, kB/frame, shared out by entropy: {', '.join(parts)}"


def _of_keys(package: Package) -> Iterator[tuple[str, float]]:
    m = package.manifest
    for g, group in enumerate(m.groups):
        for k, unit in enumerate(group.units):
            yield "means", unit.sidecar.bytes
            for media in m.key_files(g, k, 0)[1:]:
                fine = min(3 * m.qualities[-1].coarser * (unit.count - unit.kept) / 8, unit.pictures[0].bytes)
                yield "means", fine
                samples = _samples(package, media, unit.qualities[0])
                yield from _shares(unit.pictures[0].bytes - fine, unit.qualities[0], samples, KEY)


def _of_states(package: Package) -> Iterator[tuple[str, float]]:
    m = package.manifest
    for s, segment in enumerate(m.segments):
        for number, tile in enumerate(m.groups[m.group_of(s)].tiles):
            for media in m.state_files(s, 0, [number]):
                samples = _samples(package, media, tile.levels[0])
                yield from _shares(sum(segment.levels[0].frame_bytes[number]), tile.levels[0], samples, STATE)


def _samples(package: Package, media: str, atlas: Atlas) -> Iterator[NDArray[np.int16]]:
    """(P, N) of each picture."""
    for picture in decode_pictures(open_segment(package.read(media), media).samples, media, atlas.pages):
        yield extract(picture, atlas).astype(np.int16)


def _shares(
    size: float, atlas: Atlas, samples: Iterator[NDArray[np.int16]], layout: Layout
) -> Iterator[tuple[str, float]]:
    """`size` bytes shared out among the planes of an atlas, by the entropy of their changes."""
    entropy = np.zeros(len(atlas.planes))
    previous = np.zeros((len(atlas.planes), atlas.rows), np.int16)
    for picture in samples:
        for p, change in enumerate(picture - previous):
            counts = np.bincount(change + 255)  # changes of 8-bit samples
            shares = counts[counts > 0] / atlas.rows
            entropy[p] -= float((shares * np.log2(shares)).sum())
        previous = picture
    total = entropy.sum()
    for plane, part in zip(atlas.planes, entropy, strict=True):
        yield layout.attribute_of(plane), size * float(part / total if total > 0 else 1 / len(entropy))
