"""Packages and the page that plays them as a folder for any static host, such as GitHub Pages.

index.html           plays the package; of several packages a list with pictures
play/NAME.html       plays one of several
airgs-player.js      the player
airgs-vr.js          what it loads for a headset
airgs-more.js        what it loads after the first picture: keys, gestures, menu, figures and the like
airgs-sound.js       what it loads for a package with sound
packages/NAME/       a package, as it was
.nojekyll            tells GitHub Pages to serve every file as it is
"""

from __future__ import annotations

import html
import shutil
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import repeat
from pathlib import Path
from urllib.parse import quote

from airgs_codec.errors import ConfigError
from airgs_codec.package.layout import JSON_NAME, MPD_NAME, POSTER_NAME
from airgs_codec.package.mpd import check_mpd, check_shared, still_files
from airgs_codec.package.package import Package, find_file, open_package, read_file, root_of, write_file
from airgs_codec.package.parse import parse_root
from airgs_codec.places.place import Folder, is_address
from airgs_codec.places.whole import staged_folder
from airgs_codec.progress import Progress, silent
from airgs_codec.serve import pages
from airgs_codec.serve.pages import (
    PLAYER_SCRIPT,
    PLAYER_SCRIPTS,
    Glance,
    card,
    content_policy,
    look_at,
    page_of,
    title_of,
)

NO_JEKYLL = ".nojekyll"
INDEX, PACKAGES, PAGES = "index.html", "packages", "play"
MADE_BY = '<meta name="generator" content="airgs-manifest export-page">'
PLAYER_STYLE = """
html, body { height: 100%; margin: 0; background: #000 }
body { display: flex; flex-direction: column }
airgs-player { display: block; flex: 1; min-height: 0; aspect-ratio: auto }
footer { color: #aaa; font: .75rem/1.4 system-ui, sans-serif; padding: .25rem .75rem; overflow-wrap: anywhere }
"""


def export_page(
    packages: Sequence[str | Path],
    folder: str | Path,
    *,
    title: str | None = None,
    address: str = "",
    progress: Progress = silent,
) -> dict[str, Glance]:
    """Write a folder that plays packages on any static host; return what it says of each, by name.

    Every file of a package is checked against the tables as it is copied. The folder appears when it is whole, in the
    place of one that was exported before.

    packages: folders or addresses of finished packages.
    title: of the page; by default the package's name, or "Scenes" for several.
    address: where the folder will be on the web; previews of links show a picture only with its whole address.

    Raises FormatError and TransportError for a package that cannot be read, ConfigError where one is still growing,
    two have one name, the folder holds something else, or the player is not built, and OSError.
    """
    target = Path(folder).resolve()
    if not pages.is_built():
        raise ConfigError(f"{pages.PAGE_FOLDER}: {pages.NOT_BUILT}")
    opened = dict(map(_open, packages))
    if not opened or len(opened) < len(packages):
        raise ConfigError(f"{folder}: expected packages of different names, got {', '.join(map(str, packages))}")
    with staged_folder(target, _is_site, "exported page") as stage:
        (stage / NO_JEKYLL).touch()
        for name in PLAYER_SCRIPTS:
            shutil.copyfile(pages.PAGE_FOLDER / name, stage / name)
        for name, package in opened.items():
            _copy(package, name, Folder(stage / PACKAGES / name), progress)
        made = {name: look_at(p.manifest, p.root_bytes + p.mpd_bytes) for name, p in opened.items()}
        _write_pages(stage, made, title, address)
    return made


def _open(place: str | Path) -> tuple[str, Package]:
    package = open_package(place)
    if package.manifest.live:
        raise ConfigError(f"{place}: expected a finished package, got one that is still growing")
    path = Path(package.files.name)
    return (path if is_address(place) else path.resolve()).name, package


def _is_site(folder: Path) -> bool:
    """Return whether an exported page and nothing else is at the top of a folder."""
    ours = {INDEX, NO_JEKYLL, *PLAYER_SCRIPTS, PACKAGES, PAGES}
    index = folder / INDEX
    if not index.is_file() or not {path.name for path in folder.iterdir()} <= ours:
        return False
    return MADE_BY.encode() in index.read_bytes()


def _copy(package: Package, name: str, target: Folder, progress: Progress) -> None:
    """Copy the files of a package, eight at a time, and check them."""
    m, source = package.manifest, package.files
    batches = 1 + len(m.groups)
    with ThreadPoolExecutor(8) as pool:
        for number in range(batches):
            paths = m.group_files(number - 1) if number else [*m.shared_files(), *m.table_files()]
            entries = [m.entry(path) for path in paths]
            for path, data in zip(paths, pool.map(read_file, repeat(source), paths, entries), strict=True):
                write_file(target, path, data)
            progress(f"copying {name}", 1 + number, batches)
    roots = {path: find_file(source, path)[1]() for path in (MPD_NAME, JSON_NAME)}
    check_mpd(roots[MPD_NAME], m)
    for path in m.shared_files():
        check_shared(package, path)
    if parse_root(roots[JSON_NAME]) != root_of(m):
        raise ConfigError(f"{source.name}: expected a package that stays as it is, got one that changed meanwhile")
    for path, data in [*still_files(m), *roots.items()]:
        write_file(target, path, data)


def _folder(name: str) -> str:
    return f"{PACKAGES}/{quote(name)}/"


def _write_pages(site: Path, packages: Mapping[str, Glance], title: str | None, address: str) -> None:
    """Write the pages for `packages` into a folder that is going to be at `address`, "" where that is not known."""
    root = f"{address.rstrip('/')}/" if address else ""
    shown = list(packages.items())
    if len(shown) == 1:
        written = {INDEX: _player_page(*shown[0], title or title_of(shown[0][0]), "", root)}
    else:
        written = {f"{PAGES}/{name}.html": _player_page(name, s, title_of(name), "../", root) for name, s in shown}
        cards = [card(name, f"{PAGES}/{quote(name)}.html", _folder(name), seen) for name, seen in shown]
        title = title or "Scenes"
        written[INDEX] = pages.page_of_cards(title, cards, _preview(*shown[0], title, "", root))
        (site / PAGES).mkdir()
    for path, text in written.items():
        (site / path).write_text(text, encoding="utf-8")


def _player_page(name: str, seen: Glance, title: str, up: str, root: str) -> str:
    """Return a page that plays one package; `up` leads from it to the top of the site."""
    source = html.escape(f"{up}{_folder(name)}")
    poster = f' poster="{source}{POSTER_NAME}"' if seen.has_poster else ""
    credit = f"<footer>{html.escape(seen.credit)}</footer>\n" if seen.credit else ""
    policy = f'<meta http-equiv="Content-Security-Policy" content="{content_policy("")}">\n'
    body = (
        f'<airgs-player src="{source}" controls autoplay hash loop capture{poster}></airgs-player>\n{credit}'
        f'<script type="module" src="{up}{PLAYER_SCRIPT}"></script>\n'
        "<noscript>This page plays a scene with JavaScript.</noscript>\n"
    )
    return page_of(title, policy + _preview(name, seen, title, up, root), PLAYER_STYLE, body)


def _preview(name: str, seen: Glance, title: str, up: str, root: str) -> str:
    """Return who made the page, and what others show of a link to it (ogp.me)."""
    words = f"{seen.words}\n{seen.credit}".strip()
    values = {"og:type": "website", "og:title": title, "og:description": words}
    if seen.has_poster:
        values["og:image"] = f"{root or up}{_folder(name)}{POSTER_NAME}"
    tags = "".join(f'<meta property="{tag}" content="{html.escape(value)}">\n' for tag, value in values.items())
    return f'{MADE_BY}\n<meta name="description" content="{html.escape(words)}">\n{tags}'
