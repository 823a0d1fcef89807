"""The page that plays packages, and the one that lists them with a line or two about each.

The player is built from web/ into the folder `page/` (`make page`), which is a part of the installed package.
"""

from __future__ import annotations

import base64
import hashlib
import html
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from urllib.parse import quote

from airgs_codec.errors import AirgsError, ConfigError
from airgs_codec.package.manifest import Groups, Manifest, pooled_quality
from airgs_codec.package.package import open_package
from airgs_codec.package.paths import JSON_NAME, MPD_NAME

PAGE = Path(__file__).parent / "page"
PLAYER_PAGE, PLAYER_SCRIPT = "player.html", "airgs-player.js"
MODULES = ("airgs.js", "airgs-frames.js")  # for pages of others
PAGE_TYPES = {PLAYER_PAGE: "text/html"} | dict.fromkeys((PLAYER_SCRIPT, *MODULES), "text/javascript")
NOT_BUILT = "the player is not built: run make page, which needs Node 20 and npm"
_POLICY = {  # what a page may load, of each kind; nothing of any other
    "default-src": "'none'",
    "script-src": "'self'",
    "worker-src": "blob:",  # the player's workers are parts of its script
    "connect-src": "*",  # a package may lie anywhere
    "img-src": "* data: blob:",  # and so may a poster
    "style-src": "'unsafe-inline'",  # in the shadow of <airgs-player>
    "base-uri": "'none'",
    "form-action": "'none'",
}
_INLINE = re.compile(r"<script\b(?![^>]*\bsrc\s*=)[^>]*>(.*?)</script>", re.DOTALL | re.IGNORECASE)
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


def content_policy(page: str) -> str:
    """The Content-Security-Policy of an HTML page: what the player needs, and the scripts that stand in the page."""
    digests = [hashlib.sha256(script.encode()).digest() for script in _INLINE.findall(page)]
    scripts = [f"'sha256-{base64.b64encode(digest).decode()}'" for digest in digests]
    policy = _POLICY | {"script-src": " ".join([_POLICY["script-src"], *scripts])}
    return "; ".join(f"{name} {values}" for name, values in policy.items())


def player_address(name: str) -> str:
    """The address, from the root, that plays the package `name` of the same server."""
    return f"/{PLAYER_PAGE}?src={quote(f'{quote(name)}/', safe='/')}"


def is_built() -> bool:
    """Return whether the page is there; only a clone of the repository in which it was deleted has none."""
    return all((PAGE / name).is_file() for name in PAGE_TYPES)


def read_script() -> bytes:
    """The player as one script. Raises ConfigError where it is not built."""
    if not is_built():
        raise ConfigError(f"{PAGE}: {NOT_BUILT}")
    return (PAGE / PLAYER_SCRIPT).read_bytes()


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
    """Return where a package is, from the root of the server: its name, what plays it, and its tables."""
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
