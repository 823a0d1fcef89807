"""airgs-manifest: look into a package, check it, compare it with the original, put it on a page.

What a subcommand needs is imported when it runs, so that looking into a package takes no longer than reading it.
"""

from __future__ import annotations

import json
from dataclasses import field
from functools import partial
from pathlib import Path
from typing import Any

from airgs_codec._settings import required, setting
from airgs_codec.cli.options import (
    AXIS,
    PACKAGE,
    BakingOptions,
    Given,
    as_options,
    epilogue,
    expect_folder,
    make_app,
    open_frames,
    read_three,
    run_program,
)
from airgs_codec.cli.terminal import Bar, say
from airgs_codec.errors import ConfigError
from airgs_codec.package.package import open_package
from airgs_codec.package.region import world_words


@as_options
class Inspect:
    package: str = required(PACKAGE)
    plot: Path | None = setting(None, "write a PNG of the ladder and of bytes over time", metavar="FILE")
    json: bool = setting(False, "the same as JSON")


def inspect(options: Inspect) -> int:
    """Show groups, tiers, levels, rungs, bytes and what was left out."""
    from airgs_codec.inspect.stiff import stiff_cases
    from airgs_codec.inspect.summary import format_summary, plot_ladder, summarise

    if options.plot:
        expect_folder(options.plot.absolute().parent)
    package = open_package(options.package)
    tables = package.manifest, package.manifest_bytes
    if options.plot:
        plot_ladder(*tables, options.plot)
    stiff = stiff_cases(package)
    more = [*(f"stiff: {line}" for line in stiff), *([f"picture: {options.plot}"] if options.plot else [])]
    say(
        json.dumps(summarise(*tables) | {"stiff": stiff})
        if options.json
        else "\n".join([format_summary(*tables), *more])
    )
    return 0


@as_options
class Validate:
    package: str = required(PACKAGE)
    against: str | None = setting(None, "the original: measure the errors again", metavar="SEQUENCE")
    json: bool = setting(False, "findings as JSON")
    baking: BakingOptions = field(default_factory=BakingOptions)


def validate(options: Validate) -> int:
    """Check every rule of the format: status 0, or 1 with one line a finding."""
    from airgs_codec.inspect import validate as check
    from airgs_codec.inspect.errors import format_errors, measure_errors

    against, baking = options.against, vars(options.baking)
    original = open_frames(against, quiet=options.json, **baking) if against else None
    findings, measured = check.validate(options.package), []
    if not findings and original is not None:
        measured = list(measure_errors(open_package(options.package), original))
        findings = check.exceeded(measured)
    if options.json:
        say(json.dumps([{"reason": f.reason, "where": f.where, "detail": f.detail} for f in findings]))
    elif findings:
        say("\n".join(str(f) for f in findings))
    else:
        m = open_package(options.package).manifest
        counts = f"{len(m.groups)} groups, {len(m.segments)} segments, {2 + sum(1 for _ in m.files())} files"
        say(f"valid: {m.length}, {counts}")
        if measured:
            say(format_errors(measured))
    return 1 if findings else 0


POINT: Given = {"read": read_three(float, "X,Y,Z"), "metavar": "X,Y,Z", "allow_leading_hyphen": True}


@as_options
class SetView:
    package: str = required(PACKAGE)
    up: tuple[float, ...] | None = setting(None, "direction that points up, x, -y, … or X,Y,Z", **AXIS)
    position: tuple[float, ...] | None = setting(None, "where viewers begin, with --look-at", **POINT)
    look_at: tuple[float, ...] | None = setting(None, "the point that they look at", **POINT)
    name: str | None = setting(None, "add the view under this name, instead of beginning there")


def set_view(options: SetView) -> int:
    """Change where viewers begin, which way is up, and named views, without encoding again."""
    from airgs_codec.package.publish import set_view as change

    position, focus = options.position, options.look_at
    if (position is None) != (focus is None) or (options.name and position is None):
        raise ConfigError("set-view: expected --position and --look-at together, and with --name")
    view = (position, focus) if position is not None and focus is not None else None
    root = change(options.package, up=options.up, view=view, name=options.name)
    names = ", ".join(place.name for place in root.region.places if place.name) or "none"
    at = ", ".join(f"{number:.6g}" for number in root.region.places[0].position)
    say(f"{options.package}: viewers begin at ({at}); {world_words(root.world)}; named views: {names}")
    return 0


@as_options
class ExportPage:
    packages: tuple[str, ...] = required(PACKAGE)
    output: Path = required("folder to write: new, empty, or one that this command wrote", alias="-o")
    title: str | None = setting(None, "title of the page", default="the package's name")
    address: str = setting("", "where the folder will be on the web: previews of links need it", metavar="URL")


def export_page(options: ExportPage) -> int:
    """Write a folder for any static host, with the player and packages."""
    from airgs_codec.serve.export import export_page as export

    with Bar() as bar:
        made = export(options.packages, options.output, title=options.title, address=options.address, progress=bar)
    say("\n".join(f"{name}: {seen.words}" for name, seen in made.items()))
    say(f"{options.output}: to look at it, python3 -m http.server --directory {options.output}")
    return 0


app = make_app("airgs-manifest", about="Look into a package, check it, compare it with the original, put it on a page.")
COMPARE = "airgs_codec.cli.compare"  # loads the renderer: imported when it runs
COMMANDS: dict[str, Any] = {
    "inspect": inspect,
    "validate": validate,
    "set-view": set_view,
    "export-page": export_page,
    "compare": f"{COMPARE}:compare",
    "rungs": f"{COMPARE}:rungs",
}
ABOUT = {
    "compare": "Compare two scenes or packages: PSNR, SSIM, CIEDE2000, bytes, pictures.",
    "rungs": "Measure PSNR, SSIM and CIEDE2000 of every rung against the original.",
}
for name, command in COMMANDS.items():
    app.command(command, name=name, help=ABOUT.get(name), help_epilogue=epilogue(f"airgs-manifest {name}"))
main = partial(run_program, "airgs-manifest", app)
