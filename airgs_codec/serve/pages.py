"""Pages of the server and of exported sites: the player, its address and what it may load; packages as cards in a list.

The player is built from web/ into the folder `page/` (`make page`), which is a part of the installed package. What
packages say of themselves is only text.
"""

from __future__ import annotations

import base64
import hashlib
import html
import logging
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from urllib.parse import quote

from airgs_codec.errors import AirgsError, FormatError
from airgs_codec.package.layout import JSON_NAME, MPD_NAME, POSTER_NAME
from airgs_codec.package.manifest import Groups, Manifest, quality_of, rungs_of
from airgs_codec.package.package import open_package

PAGE_FOLDER = Path(__file__).parent / "page"
PLAYER_PAGE, PLAYER_SCRIPT = "player.html", "airgs-player.js"
# the first loads the others, from the same folder
PLAYER_SCRIPTS = (PLAYER_SCRIPT, "airgs-vr.js", "airgs-more.js", "airgs-sound.js")
MODULES = ("airgs.js", "airgs-frames.js")  # for pages of others
LIST_SCRIPT = "airgs-list.js"
PAGE_TYPES = {PLAYER_PAGE: "text/html"} | dict.fromkeys((*PLAYER_SCRIPTS, *MODULES, LIST_SCRIPT), "text/javascript")
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
PASSING = ("missing_file", "unsafe_path", "size_mismatch", "hash_mismatch")  # pass without a change of airgs.json
GROUPS_READ = 8  # of a package, at most: more would take too long
LIST_STYLE = """
:root { color-scheme: light dark }
body { font: 1rem/1.45 system-ui, sans-serif; margin: 0 auto; max-width: 76rem; padding: 1rem }
h1 { font-size: 1.4rem; margin: 0 0 1rem }
ul { list-style: none; margin: 0; padding: 0; display: grid; gap: 1rem;
  grid-template-columns: repeat(auto-fill, minmax(min(100%, 17rem), 1fr)) }
li { border: 1px solid #8884; border-radius: .75rem; overflow: hidden; overflow-wrap: anywhere; padding-bottom: .75rem }
li > a { display: block; color: inherit; font-size: 1.1rem; font-weight: 600; text-decoration: none }
li > a:hover, li > a:focus-visible { text-decoration: underline }
.poster { display: grid; place-items: center; position: relative; aspect-ratio: 4 / 3; margin-bottom: .6rem;
  background: #000; color: #fff9; font-size: 2.5rem }
.poster img { position: absolute; width: 100%; height: 100%; object-fit: cover }
.title, p { display: block; margin: .25rem 1rem 0 }
p { font-size: .875rem; opacity: .8 }
label { display: block; position: relative; border: 2px dashed #8888; border-radius: .75rem; padding: 1.5rem 1rem }
label.over, label:focus-within { background: #8ecbff33 }
label input { position: absolute; inset: 0; width: 100%; opacity: 0; cursor: pointer }
output, section { display: block; margin-bottom: 1rem }
"""
_log = logging.getLogger(__name__)


def content_policy(page: str) -> str:
    """Return the Content-Security-Policy of an HTML page: what the player needs, and the scripts inside the page."""
    digests = [hashlib.sha256(script.encode()).digest() for script in _INLINE.findall(page)]
    scripts = [f"'sha256-{base64.b64encode(digest).decode()}'" for digest in digests]
    policy = _POLICY | {"script-src": " ".join([_POLICY["script-src"], *scripts])}
    return "; ".join(f"{name} {values}" for name, values in policy.items())


def player_address(name: str) -> str:
    """Return the address, from the root, that plays the package `name` of the same server."""
    return f"/{PLAYER_PAGE}?src={quote(f'{quote(name)}/', safe='/')}"


def is_built() -> bool:
    """Return whether the page was built; only a clone of the repository in which it was deleted has none."""
    return all((PAGE_FOLDER / name).is_file() for name in PAGE_TYPES)


@dataclass(frozen=True, slots=True)
class Glance:
    words: str  # its length, its bytes, and the rate and PSNR of its best rung, which is the first
    credit: str  # whom the scene is by
    has_poster: bool


def look_at(m: Manifest, root_bytes: int) -> Glance:
    """Return what to say of a package from the tables of at most GROUPS_READ groups, scaled up to all frames.

    `root_bytes`: of its airgs.json and MPD. Raises FormatError where tables are refused.
    """
    first, whole = m.groups[:GROUPS_READ], len(m.groups) <= GROUPS_READ
    part = m if whole else replace(m, frames=first[-1].stop, groups=Groups.of(first))
    tables = root_bytes * part.frames // m.frames + part.bytes_of(part.table_files())
    size, top = (part.media_bytes() + tables) * m.frames // part.frames, rungs_of(part, tables)[0].bytes
    quality, about = quality_of(part, 0, 0), "" if whole else "about "
    cost = _size(top) if m.still else f"{float(8 * top * m.fps / part.frames) / 1e6:.2f} Mbit/s"
    words = [
        m.length if m.still else f"{float(m.frames / m.fps):.1f} s · {m.length}",
        f"{about}{_size(size)}",
        f"{about}{cost}{f' and {quality.psnr:.1f} dB' if quality else ''} at best",
        *(["live"] if m.live else []),
    ]
    return Glance(" · ".join(words), m.attribution, m.poster is not None)


@lru_cache(256)
def _look(folder: Path, stamp: tuple[int, int]) -> Glance | str:
    """Return what to say of a package by the stamp of its airgs.json. Raises AirgsError, OSError for passing faults."""
    try:
        package = open_package(folder)
        return look_at(package.manifest, package.root_bytes + package.mpd_bytes)
    except FormatError as error:
        if error.reason in PASSING:
            raise
        return f"cannot be played: {error}"


def describe(folder: Path) -> Glance | str:
    """Return what to say of the package in a folder, or what is wrong with it: others are listed all the same."""
    try:
        found = (folder / JSON_NAME).stat()
        seen = _look(folder, (found.st_mtime_ns, found.st_size))
    except (AirgsError, OSError) as error:
        seen = f"cannot be played: {error}"
    except Exception:
        _log.exception("%s", folder)
        seen = "cannot be played: reading it failed"
    return seen.replace(f"{folder}/", "") if isinstance(seen, str) else seen  # where it lies is nothing for strangers


def title_of(name: str) -> str:
    return name.removesuffix(".airgs")


def escape(text: str) -> str:
    """Return text of a package as HTML, with nothing in it that is not seen or cannot be sent."""
    return html.escape("".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text))


def list_page(packages: Mapping[str, Path], first: str = "") -> str:
    rows = ((name, player_address(name), f"/{quote(name)}/", describe(packages[name])) for name in sorted(packages))
    return page_of_cards("Packages", [card(*row) for row in rows], first=first)


def page_of_cards(title: str, cards: Sequence[str], head: str = "", first: str = "") -> str:
    rows = "".join(f"<li>{one}</li>\n" for one in cards)
    return page_of(title, head, LIST_STYLE, f"<h1>{html.escape(title)}</h1>\n{first}<ul>\n{rows}</ul>\n")


def page_of(title: str, head: str, style: str, body: str) -> str:
    """Return an HTML page; `head`: more elements of its head, `body`: HTML."""
    return (
        f'<!doctype html>\n<html lang="en">\n<meta charset="utf-8">\n<title>{html.escape(title)}</title>\n'
        '<meta name="viewport" content="width=device-width">\n<link rel="icon" href="data:,">\n'
        f"{head}<style>{style}</style>\n{body}</html>\n"
    )


def card(name: str, page: str, folder: str, seen: Glance | str) -> str:
    """Return a package as HTML; `page` plays it, and its files are in `folder`, which ends in /: both are addresses."""
    root = html.escape(folder)
    if isinstance(seen, str):
        picture, lines = "", [seen]
    else:
        picture = f'<img src="{root}{POSTER_NAME}" alt="" loading="lazy">' if seen.has_poster else "▷"
        lines = [seen.words, *seen.credit.split("\n")]
    files = " · ".join(f'<a href="{root}{path}">{path}</a>' for path in (JSON_NAME, MPD_NAME))
    head = f'<span class="poster">{picture}</span><span class="title">{escape(title_of(name))}</span>'
    about = "".join(f"<p>{escape(line)}</p>" for line in lines if line)
    return f'<a href="{html.escape(page)}">{head}</a>{about}<p>{files}</p>'


def _size(count: int) -> str:
    if count < 1e6:
        return f"{count / 1e3:.3g} kB"
    return f"{count / 1e6:.3g} MB" if count < 1e9 else f"{count / 1e9:.3g} GB"
