"""What is served, at a glance: a page with a line or two about each package and the link that plays it."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from urllib.parse import quote

from airgs_codec.errors import AirgsError
from airgs_codec.package.manifest import Groups, Manifest, pooled_quality
from airgs_codec.package.paths import JSON_NAME, MPD_NAME
from airgs_codec.package.store import open_package
from airgs_codec.serve.player import player_address

LOOKED_AT = 8  # groups of a package: a longer one would take too long
STYLE = """
:root { color-scheme: light dark }
body { font: 1rem/1.5 system-ui, sans-serif; margin: 0 auto; max-width: 44rem; padding: 1rem }
h1 { font-size: 1.4rem }
ul { list-style: none; padding: 0; display: grid; gap: .75rem }
li { border: 1px solid #8886; border-radius: .75rem; padding: 1rem; overflow-wrap: anywhere }
li > a:first-child { display: block; font-size: 1.15rem; font-weight: 600; padding: .25rem 0 }
img { display: block; width: 100%; height: auto; border-radius: .5rem }
p { margin: .25rem 0; opacity: .75 }
"""


@dataclass(frozen=True, slots=True)
class Glance:
    """A package in a few figures. Bytes and PSNR are those of its first groups where there are more than LOOKED_AT."""

    frames: int
    fps: Fraction
    live: bool
    bytes: int  # of all files; scaled up to all frames where only the first groups were looked at
    whole: bool  # whether all groups were looked at
    psnr: float | None  # dB of the best rung, None where it was not measured

    @property
    def words(self) -> str:
        """The same for people."""
        about = "" if self.whole else "about "
        parts = [
            f"{about}{_size(self.bytes)}",
            f"{self.frames} frames",
            f"{float(self.frames / self.fps):.1f} s",
            *([] if self.psnr is None else [f"{about}{self.psnr:.1f} dB at best"]),
            *(["live"] if self.live else []),
        ]
        return " · ".join(parts)


def look_at(m: Manifest, root_bytes: int) -> Glance:
    """The figures of a package from the tables of a few groups. Raises FormatError where they are refused."""
    first = m.groups[:LOOKED_AT]
    whole = len(first) == len(m.groups)
    part = m if whole else replace(m, frames=first[-1].stop, groups=Groups.of(first))
    listed = part.media_bytes() + part.bytes_of(part.table_files())
    best = pooled_quality(part, 0, 0)
    size = root_bytes + listed * m.frames // part.frames
    return Glance(m.frames, m.fps, m.live, size, whole, best.psnr if best else None)


@lru_cache(256)
def _glance(folder: Path, stamp: tuple[int, int]) -> Glance:
    """The figures of a package whose airgs.json has this stamp."""
    package = open_package(folder)
    return look_at(package.manifest, package.root_bytes + package.mpd_bytes)


def describe(folder: Path) -> str:
    """A line about the package in a folder, or what is wrong with it."""
    try:
        stat = (folder / JSON_NAME).stat()
        return _glance(folder, (stat.st_mtime_ns, stat.st_size)).words
    except (AirgsError, OSError) as error:
        return f"cannot be played: {error}"


def addresses(name: str) -> dict[str, str]:
    """Where a package is, from the root of the server: its name, what plays it, and its tables."""
    folder = f"/{quote(name)}"
    return {
        "name": name,
        "play": player_address(name),
        "tables": f"{folder}/{JSON_NAME}",
        "mpd": f"{folder}/{MPD_NAME}",
    }


def list_page(packages: Mapping[str, Path]) -> str:
    """The page at the root of the server."""
    return page_of("Packages", [_item(addresses(name), describe(packages[name])) for name in sorted(packages)])


def page_of(title: str, items: Sequence[str], head: str = "") -> str:
    """An HTML page with a list; `head`: more elements of its head."""
    rows = "".join(f"<li>{item}</li>\n" for item in items)
    return (
        f'<!doctype html>\n<html lang="en">\n<meta charset="utf-8">\n<title>{html.escape(title)}</title>\n'
        '<meta name="viewport" content="width=device-width">\n<link rel="icon" href="data:,">\n'
        f"{head}<style>{STYLE}</style>\n<h1>{html.escape(title)}</h1>\n<ul>\n{rows}</ul>\n</html>\n"
    )


def _item(a: Mapping[str, str], words: str) -> str:
    link = '<a href="{}">{}</a>'.format
    more = " · ".join([link(html.escape(a["tables"]), JSON_NAME), link(html.escape(a["mpd"]), MPD_NAME)])
    play = link(html.escape(a["play"]), f"Play {html.escape(a['name'])}")
    return f"{play}<p>{html.escape(words)}</p><p>{more}</p>"


def _size(count: int) -> str:
    return f"{count / 1e6:.3g} MB" if count < 1e9 else f"{count / 1e9:.3g} GB"
