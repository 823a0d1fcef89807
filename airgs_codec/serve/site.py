"""The pages of an exported site: one that plays a package, and a list of those where there are several."""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from airgs_codec.serve.listing import page_of
from airgs_codec.serve.player import PLAYER_SCRIPT, content_policy

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
