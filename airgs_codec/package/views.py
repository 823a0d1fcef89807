"""Where viewers of a package begin, which way is up, and named views, changed later: airgs.json alone is written."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np

from airgs_codec.errors import ConfigError
from airgs_codec.package.layout import JSON_NAME, POSTER_NAME
from airgs_codec.package.package import open_package, root_of, write_file
from airgs_codec.package.parse import pack_json, parse_root
from airgs_codec.package.region import levelled, unit_of, upright, world_from
from airgs_codec.package.tables import MAX_PLACES, Place, Region, Root
from airgs_codec.places.place import Folder, place_at
from airgs_codec.places.whole import written_alone

Point = Sequence[float]


def set_view(
    path: str | Path, *, up: Point | None = None, view: tuple[Point, Point] | None = None, name: str | None = None
) -> Root:
    """Change the package at `path`, whole or not at all, and return what is written.

    `up` (3,) is up from now on. `view` is a position and the point looked at, (3,) each: viewers begin there, or, with
    a `name`, find it under that name, instead of what had it before; they may go as far from it as from the place next
    to it. A poster shows what was the first view, so it goes where that changes. Whoever else changes a package in a
    folder at this moment is waited for.

    Raises ConfigError for nothing to change or a package that is still growing, FormatError for values that no reader
    takes, OSError where nothing can be written.
    """
    place = place_at(path)
    with written_alone(place.path) if isinstance(place, Folder) and place.path.is_dir() else nullcontext():
        return _change(path, up, view, name)


def _change(path: str | Path, up: Point | None, view: tuple[Point, Point] | None, name: str | None) -> Root:
    package = open_package(path)
    root = root_of(package.manifest)
    if root.live:
        raise ConfigError(f"{path}: expected a package that is whole, got one that is still growing")
    if up is None and view is None:
        raise ConfigError(f"{path}: expected a way up or a view, got nothing to change")
    if up is not None:
        root = replace(root, world=world_from(up, unit_of(root.world) if root.world else None))
    if view is not None:
        if not np.isfinite(view).all():
            raise ConfigError(f"view: expected finite numbers, got {view[0]} and {view[1]}")
        root = replace(root, region=_with_view(root, view, name))
    if up is not None or name is None:
        root = replace(root, poster=None)
    text = pack_json(root)
    parse_root(text)
    write_file(package.files, JSON_NAME, text)
    if root.poster is None:  # a run that was killed here may have left it
        package.files.delete([POSTER_NAME])
    return root


def _with_view(root: Root, view: tuple[Point, Point], name: str | None) -> Region:
    """The region with another place, the first one unless it has a name."""
    position, focus = (list(map(float, point)) for point in view)
    region = levelled(root.region, root.world)
    away = [float(np.linalg.norm(np.subtract(place.position, position))) for place in region.places]
    reach = region.places[int(np.argmin(away))].reach
    place = Place(position, focus, upright(region).tolist(), reach, name)
    others = [other for other in root.region.places if name is None or other.name != name]
    if len(others) == MAX_PLACES:
        raise ConfigError(f"region: expected at most {MAX_PLACES} places, got one more")
    return replace(root.region, places=[place, *others] if name is None else [*others, place])
