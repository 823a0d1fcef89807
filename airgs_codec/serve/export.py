"""Packages and the page that plays them as a folder for any static host, such as GitHub Pages.

index.html           plays the package; a list with pictures where there are several
play/NAME.html       where there are several: plays one of them
airgs-player.js      the player
packages/NAME/       a package, as it was
posters/NAME.jpg     its first frame
.nojekyll            tells GitHub Pages to serve every file as it is
"""

from __future__ import annotations

import html
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from airgs_codec.decoder.decode import decode
from airgs_codec.errors import ConfigError
from airgs_codec.media.image import to_bytes, write_jpeg
from airgs_codec.package.package import Package, find_file, open_package, read_file, root_of, write_file
from airgs_codec.package.parse import parse_root
from airgs_codec.package.paths import INIT_NAME, JSON_NAME, MPD_NAME
from airgs_codec.package.region import first_place, levelled, place_view
from airgs_codec.places.place import Folder, is_address
from airgs_codec.places.whole import staged_folder
from airgs_codec.progress import Progress, silent
from airgs_codec.render import render
from airgs_codec.scene.camera import resized
from airgs_codec.serve.pages import PLAYER_SCRIPT, content_policy, look_at, page_of, read_script

PLAIN = ".nojekyll"
POSTER_SIDE = 1280  # pixels, of the longer side at most
PARALLEL = 8  # files that are read at a time
INDEX = "index.html"
PACKAGES, POSTERS, PAGES = "packages", "posters", "play"
MADE_BY = '<meta name="generator" content="airgs-manifest export-page">'
SUFFIX = ".airgs"  # of a package's name, which titles leave out
SEVERAL = "Scenes"  # title of a list
STYLE = """
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
) -> list[Exported]:
    """Write a folder that plays packages on any static host, and give what it holds.

    Every file of a package is checked against the tables as it is copied. The folder appears when it is whole, in the
    place of one that was exported before.

    packages: folders or addresses of finished packages.
    title: of the page; by default the package's name, or "Scenes" where there are several.
    address: where the folder will be on the web; previews of links show a picture only with its whole address.

    Raises FormatError and TransportError for a package that cannot be read, ConfigError where one is still growing,
    two have one name, the folder holds something else, or the player is not built, and OSError.
    """
    target, script = Path(folder).resolve(), read_script()
    opened = dict(map(_open, packages))
    if not opened or len(opened) < len(packages):
        raise ConfigError(f"{folder}: expected packages of different names, got {', '.join(map(str, packages))}")
    with staged_folder(target, _is_site, "exported page") as stage:
        (stage / PLAIN).touch()
        (stage / PLAYER_SCRIPT).write_bytes(script)
        (stage / POSTERS).mkdir()
        made = [_export(stage, name, package, progress) for name, package in opened.items()]
        write_pages(stage, made, title, address)
    return made


def _open(place: str | Path) -> tuple[str, Package]:
    """A package under its name."""
    package = open_package(place)
    if package.manifest.live:
        raise ConfigError(f"{place}: expected a finished package, got one that is still growing")
    path = Path(package.files.name)
    return (path if is_address(place) else path.resolve()).name, package


def _is_site(folder: Path) -> bool:
    """Return whether an exported page and nothing else is at the top of a folder."""
    ours = {INDEX, PLAIN, PLAYER_SCRIPT, PACKAGES, POSTERS, PAGES}
    index = folder / INDEX
    if not index.is_file() or not {path.name for path in folder.iterdir()} <= ours:
        return False
    return MADE_BY.encode() in index.read_bytes()


def _export(stage: Path, name: str, package: Package, progress: Progress) -> Exported:
    """Copy one package and draw its poster."""
    m = package.manifest
    copied = _copy(package, name, Folder(stage / PACKAGES / name), progress)
    poster = _poster(package)
    write_jpeg(stage / poster_path(name), poster)
    words = look_at(m, package.root_bytes + package.mpd_bytes).words
    return Exported(name, words, m.attribution, copied, (poster.shape[1], poster.shape[0]))


def _copy(package: Package, name: str, target: Folder, progress: Progress) -> int:
    """Copy the files of a package, checked, and give their length together."""
    m, source = package.manifest, package.files
    batches = 1 + len(m.groups)
    size = 0
    with ThreadPoolExecutor(PARALLEL) as pool:
        for number in range(batches):
            paths = m.group_files(number - 1) if number else [INIT_NAME, *m.table_files()]
            entries = [m.entry(path) for path in paths]
            for path, data in zip(paths, pool.map(read_file, repeat(source), paths, entries), strict=True):
                size += write_file(target, path, data).bytes
            progress(f"copying {name}", 1 + number, batches)
    roots = {path: find_file(source, path)[1]() for path in (MPD_NAME, JSON_NAME)}
    if parse_root(roots[JSON_NAME]) != root_of(m):
        raise ConfigError(f"{source.name}: expected a package that stays as it is, got one that changed meanwhile")
    return size + sum(write_file(target, path, data).bytes for path, data in roots.items())


def _poster(package: Package) -> NDArray[np.uint8]:
    """(H, W, 3) the first frame from the first place of the region."""
    region = levelled(package.manifest)
    camera = place_view(region, first_place(region))
    camera = resized(camera, POSTER_SIDE / max(camera.width, camera.height))
    return to_bytes(render(decode(package, 0), camera).rgb)


@dataclass(frozen=True, slots=True)
class Exported:
    """A package in a site."""

    name: str
    words: str  # its figures, for people
    credit: str  # whom the scene is by
    bytes: int  # of its files
    poster: tuple[int, int]  # width and height in pixels

    @property
    def title(self) -> str:
        """Its name as a title."""
        return self.name.removesuffix(SUFFIX)


def poster_path(name: str) -> str:
    """The poster of a package."""
    return f"{POSTERS}/{name}.jpg"


def write_pages(site: Path, packages: Sequence[Exported], title: str | None, address: str) -> None:
    """Write the pages for `packages` into a folder that is going to be at `address`, "" where nobody knows it."""
    root = f"{address.rstrip('/')}/" if address else ""
    if len(packages) == 1:
        pages = {INDEX: _player_page(packages[0], title or packages[0].title, "", root)}
    else:
        pages = {_page_path(p.name): _player_page(p, p.title, "../", root) for p in packages}
        pages[INDEX] = _list_page(packages, title or SEVERAL, root)
        (site / PAGES).mkdir()
    for path, text in pages.items():
        (site / path).write_text(text, encoding="utf-8")


def _page_path(name: str) -> str:
    return f"{PAGES}/{name}.html"


def _player_page(package: Exported, title: str, up: str, root: str) -> str:
    """A page that plays one package; `up` leads from it to the top of the site."""
    source, poster = f"{up}{PACKAGES}/{quote(package.name)}/", f"{up}{quote(poster_path(package.name))}"
    attributes = f'src="{html.escape(source)}" poster="{html.escape(poster)}" controls autoplay loop capture'
    credit = f"<footer>{html.escape(package.credit)}</footer>\n" if package.credit else ""
    policy = f'<meta http-equiv="Content-Security-Policy" content="{content_policy("")}">\n'
    return (
        f'<!doctype html>\n<html lang="en">\n<meta charset="utf-8">\n<title>{html.escape(title)}</title>\n'
        f'<meta name="viewport" content="width=device-width">\n<link rel="icon" href="data:,">\n{policy}'
        f"{_preview(package, title, up, root)}<style>{STYLE}</style>\n"
        f"<airgs-player {attributes}></airgs-player>\n{credit}"
        f'<script type="module" src="{up}{PLAYER_SCRIPT}"></script>\n'
        "<noscript>This page plays a scene with JavaScript.</noscript>\n</html>\n"
    )


def _list_page(packages: Sequence[Exported], title: str, root: str) -> str:
    return page_of(title, [_item(package) for package in packages], _preview(packages[0], title, "", root))


def _item(package: Exported) -> str:
    width, height = package.poster
    page, poster = (html.escape(quote(path(package.name))) for path in (_page_path, poster_path))
    picture = f'<img src="{poster}" width="{width}" height="{height}" alt="" loading="lazy">'
    credit = f"<p>{html.escape(package.credit)}</p>" if package.credit else ""
    return f'<a href="{page}">{picture}{html.escape(package.title)}</a><p>{html.escape(package.words)}</p>{credit}'


def _preview(package: Exported, title: str, up: str, root: str) -> str:
    """Who made the page, and what others show of a link to it (ogp.me)."""
    width, height = package.poster
    words = f"{package.words}\n{package.credit}".strip()
    values = {
        "og:type": "website",
        "og:title": title,
        "og:description": words,
        "og:image": f"{root or up}{quote(poster_path(package.name))}",
        "og:image:width": str(width),
        "og:image:height": str(height),
    }
    tags = "".join(f'<meta property="{name}" content="{html.escape(value)}">\n' for name, value in values.items())
    return f'{MADE_BY}\n<meta name="description" content="{html.escape(words)}">\n{tags}'
