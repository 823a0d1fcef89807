"""What a package does not have and why, in words: what its encoder left out, and planes that would be constant."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import numpy as np

from airgs_codec.media.metrics import psnr
from airgs_codec.package.layout import KEY, STATE, Layout
from airgs_codec.package.manifest import Manifest
from airgs_codec.package.paths import tile_folder
from airgs_codec.package.tables import Atlas, LeftOut

FEW = 4  # groups that are listed one by one
_NAMES = {"gaussians": "Gaussians", "updates": "rows are never updated"}


def describe_left_out(m: Manifest) -> list[str]:
    """One line each; what concerns more than FEW groups alike is one line."""
    lines = [*_decisions(m), *_constant(m)]
    quiet = sum(not s.levels[0].bytes for s in m.segments)
    if quiet:
        lines.append(f"{quiet} state segments: nothing moves in them by more than half a step")
    if m.sh_degree == 0:
        lines.append("SH rest: the scene has none")
    return lines


def _decisions(m: Manifest) -> Iterator[str]:
    """The entries of `left_out`, by what they are."""
    entries: dict[str, list[tuple[int, LeftOut]]] = {}
    for number, group in enumerate(m.groups):
        for entry in group.left_out:
            entries.setdefault(entry.what, []).append((number, entry))
    for what, same in entries.items():
        groups = [same] if len(same) > FEW else [[one] for one in same]
        yield from (_sentence(what, [number for number, _ in some], [entry for _, entry in some]) for some in groups)


def _sentence(what: str, groups: list[int], entries: list[LeftOut]) -> str:
    """A line about one group, or about many: ranges, and the largest error."""
    error = max(entry.error for entry in entries)
    alone = f"{psnr(error):.1f} dB by itself" if error > 0 else "no error"
    saved = f"{np.mean([entry.bytes for entry in entries]) / 1e3:.2f} kB/frame saved"
    count = span(min(entry.count for entry in entries), max(entry.count for entry in entries))
    where = f"group {groups[0]}" if len(groups) == 1 else f"{len(groups)} groups"
    worst = "at worst " if len(groups) > 1 and error > 0 else ""
    return f"{where}: {count} {_NAMES.get(what, what)}: {worst}{alone}, {saved}"


def _constant(m: Manifest) -> Iterator[str]:
    """Tiers without rows, and channels without a plane in the top rung."""
    groups: dict[str, list[int]] = {}
    for i, group in enumerate(m.groups):
        tiles = [(tile_folder(number, m.tiles), tile) for number, tile in enumerate(group.tiles)]
        tiers = [(f"{folder}T{t}", tier) for folder, tile in tiles for t, tier in enumerate(tile.tiers)]
        for name, tier in tiers:
            if not tier.count:
                groups.setdefault(f"key tier {name}: it has no rows", []).append(i)
        keys = [(f"key {name} Q0", tier.qualities[0], KEY) for name, tier in tiers]
        states = [(f"state {folder}L0", tile.levels[0], STATE) for folder, tile in tiles]
        for name, atlas, layout in (*keys, *states):
            if text := _without_plane(atlas, layout):
                groups.setdefault(f"planes of {name}: {text} (constant within half a step)", []).append(i)
    for text, where in groups.items():
        yield from [f"{len(where)} groups: {text}"] if len(where) > FEW else [f"group {i}: {text}" for i in where]


def _without_plane(atlas: Atlas, layout: Layout) -> str:
    """How many channels of which attribute have no plane; empty when all have one."""
    missing = set(range(len(atlas.centres) if atlas.rows else 0)) - set(atlas.planes)
    counts = Counter(layout.attribute_of(channel) for channel in sorted(missing))
    return ", ".join(f"{count} {attribute}" for attribute, count in counts.items())


def span(low: int, high: int) -> str:
    """A range of whole numbers."""
    return str(low) if low == high else f"{low}-{high}"
