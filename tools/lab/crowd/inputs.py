"""What of a package matters for serving it: bytes a second of media by rung, storage a minute, files a second."""

from __future__ import annotations

from airgs_codec.package.manifest import Manifest, pooled_quality
from airgs_codec.package.package import Package
from airgs_codec.package.paths import FileKind, file_kind
from tools.lab.page import Row


def rung_rows(package: Package) -> list[Row]:
    """What a viewer of one rung fetches for a second of media, without headers and tables, by rung."""
    m, rows = package.manifest, []
    seconds = m.frames / float(m.fps)
    for q, quality in enumerate(m.qualities):
        for j, level in enumerate(m.levels):
            paths, pooled = m.rung_files(q, j), pooled_quality(m, j, q)
            size = m.bytes_of(paths)
            rows.append(
                {
                    "rung": f"{quality.id}+{level.id}",
                    "psnr": None if pooled is None else pooled.psnr,
                    "mbps": 8e-6 * size / seconds,
                    "mb_minute": 60e-6 * size / seconds,
                    "files_s": len(paths) / seconds,
                }
            )
    return rows


def stored_rows(package: Package) -> list[Row]:
    """MB that a minute of media takes at the origin by kind of file; airgs.json and manifest.mpd are not in it."""
    m = package.manifest
    sizes: dict[FileKind, list[int]] = {}
    for path in m.files():
        sizes.setdefault(file_kind(path), []).append(m.entry(path).bytes)
    sizes.pop(FileKind.INIT, None)  # one for the whole programme
    return [_stored(m, kind.value, found) for kind, found in sizes.items()]


def _stored(m: Manifest, kind: str, found: list[int]) -> Row:
    seconds = m.frames / float(m.fps)
    return {"kind": kind, "mb_minute": 60e-6 * sum(found) / seconds, "files_s": len(found) / seconds}
