"""Packages as pages get them that draw but do not decode: tables, luma, changes of bases, means, and true pictures.

`write_decoded` makes two files: NAME.json, and NAME.bin, into which "references" in it point: type, byte, count.
"""

from __future__ import annotations

import gzip
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding import escapes
from airgs_codec.coding.atlas import GREY, plane_starts, row_places
from airgs_codec.decoder.decode import read_keyframe
from airgs_codec.render import cpu
from tests.faces import Atlas, Camera, Package, decode_canonical, decode_frames, decode_pictures

ALIGNMENT = 8  # bytes
BLOCK = 16  # samples either side
Json = dict[str, Any]


@dataclass
class Blob:
    data: bytearray = field(default_factory=bytearray)

    def add(self, array: NDArray[Any]) -> list[str | int]:
        self.data += bytes(-len(self.data) % ALIGNMENT)
        at = len(self.data)
        self.data += np.ascontiguousarray(array).tobytes()
        return [array.dtype.name, at, array.size]


@dataclass(frozen=True)
class Rung:
    """What a viewer shows: indices of keyframe quality and level, and its number of keyframe tiers; None: all."""

    quality: int
    level: int
    tiers: int | None = None


def write_decoded(package: Package, where: Path, rungs: list[Rung], cameras: Sequence[Camera], pages: int = 1) -> None:
    """Write what `package` decodes to, with what every camera sees of each frame on black.

    `pages`: cut every atlas into as many as that, or as near as whole blocks come to it.
    """
    blob, folder = Blob(), Path(package.files.name)
    tables = [folder / f"group/{number}.json.gz" for number in range(1, len(package.manifest.groups) + 1)]
    groups = [json.loads(gzip.decompress(table.read_bytes())) for table in tables]
    for group in groups:
        for atlas in [a for row in (group["levels"], *(t["qualities"] for t in group["tiers"])) for a in row]:
            atlas["height"] = _page_height(Atlas(**atlas), pages)
    table = {
        "root": json.loads((folder / "airgs.json").read_bytes()),
        "groups": groups,
        "cameras": [
            {name: getattr(c, name) for name in ("width", "height", "fx", "fy", "cx", "cy", "near")}
            | {"worldToCamera": c.world_to_camera.ravel().tolist()}
            for c in cameras
        ],
        "rungs": [_Writer(package, blob, rung, pages).table(cameras) for rung in rungs],
    }
    where.with_suffix(".json").write_text(json.dumps(table))
    where.with_suffix(".bin").write_bytes(blob.data)


@dataclass(frozen=True)
class _Writer:
    package: Package
    blob: Blob
    rung: Rung
    pages: int

    @property
    def tiers(self) -> int:
        asked = self.package.manifest.levels[self.rung.level].tiers
        return asked if self.rung.tiers is None else self.rung.tiers

    def table(self, cameras: Sequence[Camera]) -> Json:
        m, level, quality = self.package.manifest, self.rung.level, self.rung.quality
        frames = decode_frames(self.package, 0, m.frames, level=level, keyframe_quality=quality, tiers=self.tiers)
        shown, groups = [], []
        for g in (frame.gaussians for frame in frames):
            pictures = [self.blob.add(cpu.render(g, camera).rgb) for camera in cameras]
            shown.append({"means": self.blob.add(g.means), "pictures": pictures})
        for number in range(len(m.groups)):
            segments = []
            for s in m.segments_of(number):
                span = range(m.segments[s].start, m.segments[s].stop)
                states = self._states(s) or [{"luma": None, "changes": None, "time": 0} for _ in span]
                segments.append([state | shown[n] for n, state in zip(span, states, strict=True)])
            groups.append({"canonical": self._canonical(number), "segments": segments})
        return {"quality": quality, "level": level, "tiers": self.tiers, "groups": groups}

    def _canonical(self, group: int) -> Json:
        base = decode_canonical(self.package, group, self.rung.quality, self.tiers)
        tiers = self.package.manifest.groups[group].tiers[: self.tiers]
        return {
            "means": self.blob.add(base.means.astype(np.float32)),
            "units": self.blob.add(base.motion_units),
            "depths": self.blob.add(base.depths),
            "parts": [self._tier(group, t) | {"tier": t} for t, tier in enumerate(tiers) if tier.count],
        }

    def _tier(self, group: int, tier: int) -> Json:
        """The picture of a tier that has rows, of the base where there is one, with that of the difference to it."""
        base = self.package.manifest.base_of(group)
        difference = None if base is None else self._key(group, tier)
        picture = self._key(group if base is None else base, tier)
        return (picture or {}) | {"difference": difference}

    def _key(self, group: int, tier: int) -> Json | None:
        atlas = self.package.manifest.groups[group].tiers[tier].qualities[self.rung.quality]
        shown, _ = read_keyframe(self.package, group, tier, self.rung.quality)
        return None if shown is None else self._picture(shown.luma[0], atlas, _dense(atlas, shown.luma[1]))

    def _states(self, index: int) -> list[Json]:
        """Every frame of a segment; none where there is nothing to fetch."""
        m, level, before = self.package.manifest, self.rung.level, None
        out: list[Json] = []
        if not m.delta_files(index, level):
            return out
        frames = range(m.segments[index].stop - m.segments[index].start)
        for state in decode_pictures(self.package, index, level, frames):
            now = _dense(state.atlas, state.luma[1])
            shown = self._picture(state.luma[0], state.atlas, now, before)
            if state.slopes and not out:
                slopes = self._cut(state.slopes[0], state.atlas).astype(np.int32) - GREY
                slopes.ravel()[self._places(state.atlas)] += escapes.UNIT * _dense(state.atlas, state.slopes[1])
                nothing = {"texels": self.blob.add(np.empty(0, np.uint32)), "bases": self.blob.add(now[:0].ravel())}
                shown["changes"] = (shown["changes"] or nothing) | {"slopes": self.blob.add(slopes)}
            out.append(shown | {"time": state.time})
            before = now
        return out

    def _cut(self, picture: NDArray[np.uint8], atlas: Atlas) -> NDArray[np.uint8]:
        height, lines = _page_height(atlas, self.pages), atlas.size[1]
        luma = np.full((-(-lines // height) * height, atlas.width), GREY, np.uint8)
        luma[:lines] = picture[:lines]
        return luma

    def _places(self, atlas: Atlas) -> NDArray[np.intp]:
        return np.add.outer(plane_starts(atlas, atlas.width), row_places(atlas.rows, atlas.plane_width, atlas.width))

    def _picture(
        self, picture: NDArray[np.uint8], atlas: Atlas, now: NDArray[np.int32], before: NDArray[np.int32] | None = None
    ) -> Json:
        """Luma cut into pages anew, and what changes of its bases."""
        changed = now != (0 if before is None else before)
        texels = self._places(atlas)[changed].astype(np.uint32)
        changes = {"texels": self.blob.add(texels), "bases": self.blob.add(now[changed])}
        return {"luma": self.blob.add(self._cut(picture, atlas)), "changes": changes if changed.any() else None}


def _dense(atlas: Atlas, bases: escapes.Bases) -> NDArray[np.int32]:
    rows = [np.zeros(atlas.rows, np.int32) if base is None else base for base in bases]
    return np.array(rows, np.int32).reshape(len(atlas.planes), atlas.rows)


def _page_height(atlas: Atlas, pages: int) -> int:
    """The height of pictures when an atlas is cut into `pages`; 1: as it is."""
    if pages == 1 or not atlas.planes:
        return atlas.height
    return BLOCK * -(-atlas.size[1] // (BLOCK * pages))
