"""airgs-manifest set-view: where viewers of a package begin, which way is up, and named views."""

from __future__ import annotations

from dataclasses import dataclass

from airgs_codec._settings import setting
from airgs_codec.cli.common import package, read_up
from airgs_codec.cli.options import takes
from airgs_codec.cli.terminal import say
from airgs_codec.errors import ConfigError
from airgs_codec.package.publish import set_view as change
from airgs_codec.package.region import world_words


def read_point(text: str) -> tuple[float, ...]:
    """Returns the numbers of X,Y,Z. Raises ConfigError."""
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError as error:
        raise ConfigError(f"expected X,Y,Z, got {text!r}") from error
    return x, y, z


@dataclass(frozen=True, slots=True)
class SetView:
    package: str = package()
    up: tuple[float, ...] | None = setting(
        None, "direction that points up, x, -y, … or X,Y,Z", read=read_up, metavar="AXIS", signed=True
    )
    position: tuple[float, ...] | None = setting(
        None, "where viewers begin, with --look-at", read=read_point, metavar="X,Y,Z", signed=True
    )
    look_at: tuple[float, ...] | None = setting(
        None, "the point that they look at", read=read_point, metavar="X,Y,Z", signed=True
    )
    name: str | None = setting(None, "viewers find that view by this name; they do not begin there")


@takes(SetView)
def set_view(options: SetView) -> int:
    """Change where viewers begin, which way is up, and named views, without encoding again."""
    position, focus = options.position, options.look_at
    if (position is None) != (focus is None) or (options.name and position is None):
        raise ConfigError("set-view: expected --position and --look-at together, and with --name")
    view = (position, focus) if position is not None and focus is not None else None
    root = change(options.package, up=options.up, view=view, name=options.name)
    names = ", ".join(place.name for place in root.region.places if place.name) or "none"
    at = ", ".join(f"{number:.6g}" for number in root.region.places[0].position)
    say(f"{options.package}: viewers begin at ({at}); {world_words(root.world)}; named views: {names}")
    return 0
