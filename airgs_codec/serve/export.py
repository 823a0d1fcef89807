"""Packages and the page that plays them as a folder for any static host, such as GitHub Pages.

index.html           plays the package; a list with pictures where there are several
play/NAME.html       where there are several: plays one of them
airgs-player.js      the player
packages/NAME/       a package, as it was
posters/NAME.jpg     its first frame
.nojekyll            tells GitHub Pages to serve every file as it is
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import repeat
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec._stores import is_address
from airgs_codec.decoder.decode import decode
from airgs_codec.errors import ConfigError
from airgs_codec.media.image import to_bytes, write_jpeg
from airgs_codec.package.folder import Folder
from airgs_codec.package.parse import parse_root
from airgs_codec.package.paths import INIT_NAME, JSON_NAME, MPD_NAME
from airgs_codec.package.region import first_place, levelled, place_view
from airgs_codec.package.staging import staged
from airgs_codec.package.store import Package, open_package, read_file, root_of
from airgs_codec.progress import Progress, silent
from airgs_codec.render import render
from airgs_codec.scene.camera import resized
from airgs_codec.serve.listing import look_at
from airgs_codec.serve.player import PLAYER_SCRIPT, read_script
from airgs_codec.serve.site import INDEX, MADE_BY, PACKAGES, PAGES, POSTERS, Exported, poster_path, write_pages

PLAIN = ".nojekyll"
POSTER_SIDE = 1280  # pixels, of the longer side at most
PARALLEL = 8  # files that are read at a time


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
    with staged(target, _is_site, "exported page") as stage:
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
    """Whether an exported page and nothing else is at the top of a folder."""
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
                size += target.write(path, data).bytes
            progress(f"copying {name}", 1 + number, batches)
    roots = {path: source.open(path)[1]() for path in (MPD_NAME, JSON_NAME)}
    if parse_root(roots[JSON_NAME]) != root_of(m):
        raise ConfigError(f"{source.name}: expected a package that stays as it is, got one that changed meanwhile")
    return size + sum(target.write(path, data).bytes for path, data in roots.items())


def _poster(package: Package) -> NDArray[np.uint8]:
    """(H, W, 3) the first frame from the first place of the region."""
    region = levelled(package.manifest)
    camera = place_view(region, first_place(region))
    camera = resized(camera, POSTER_SIDE / max(camera.width, camera.height))
    return to_bytes(render(decode(package, 0), camera).rgb)
