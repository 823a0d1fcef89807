"""airgs-manifest: look into a package, check it, compare it with the original, put it on a page.

What a subcommand needs is imported when it runs, so that looking into a package takes no longer than reading it.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from airgs_codec._report import require_matplotlib
from airgs_codec._settings import required, setting
from airgs_codec.cli.common import PACKAGE, BakingOptions, as_json, expect_folder, open_frames, package
from airgs_codec.cli.options import App, make_app, nested, run_program, takes
from airgs_codec.cli.terminal import Bar, say
from airgs_codec.package.package import open_package


@dataclass(frozen=True, slots=True)
class Inspect:
    package: str = package()
    plot: Path | None = setting(None, "write a PNG of the ladder and of bytes over time", metavar="FILE")
    json: bool = as_json("the same as JSON")


@takes(Inspect)
def inspect(options: Inspect) -> int:
    """Show groups, tiers, levels, rungs, bytes and what was left out."""
    from airgs_codec.inspect.summary import format_summary, plot_ladder, summarise

    if options.plot:
        require_matplotlib("--plot")
        expect_folder(options.plot.absolute().parent)
    package = open_package(options.package)
    tables = package.manifest, package.manifest_bytes
    if options.plot:
        plot_ladder(*tables, options.plot)
    if options.json:
        say(json.dumps(summarise(*tables)))
        return 0
    say(format_summary(*tables))
    if options.plot:
        say(f"picture: {options.plot}")
    return 0


@dataclass(frozen=True, slots=True)
class Validate:
    package: str = package()
    against: str | None = setting(None, "the original: measure the errors again", metavar="SEQUENCE")
    clip: BakingOptions = nested(BakingOptions, "clips", own=True)
    json: bool = as_json("findings as JSON")


@takes(Validate)
def validate(options: Validate) -> int:
    """Check every rule of the format: status 0, or 1 with one line a finding."""
    from airgs_codec.inspect import validate as check
    from airgs_codec.inspect.errors import format_errors, measure_errors

    against = open_frames(options.against, quiet=options.json, **options.clip.baking()) if options.against else None
    findings, measured = check.validate(options.package), []
    if not findings and against is not None:
        measured = list(measure_errors(open_package(options.package), against))
        findings = check.exceeded(measured)
    if options.json:
        say(json.dumps([dataclasses.asdict(finding) for finding in findings]))
    elif findings:
        say("\n".join(str(f) for f in findings))
    else:
        m = open_package(options.package).manifest
        count = 2 + sum(1 for _ in m.files())
        say(f"valid: {m.frames} frames, {len(m.groups)} groups, {len(m.segments)} segments, {count} files")
        if measured:
            say(format_errors(measured))
    return 1 if findings else 0


@dataclass(frozen=True, slots=True)
class ExportPage:
    packages: tuple[str, ...] = required(PACKAGE, metavar="PACKAGE")
    output: Path = required("folder to write: new, empty, or one that this command wrote", short="-o")
    title: str | None = setting(None, "title of the page (default: the package's name)")
    address: str = setting("", "where the folder will be on the web: previews of links need it", metavar="URL")


@takes(ExportPage)
def export_page(options: ExportPage) -> int:
    """Write a folder for any static host, with the player and packages."""
    from airgs_codec.serve.export import export_page as export

    with closing(Bar()) as bar:
        made = export(options.packages, options.output, title=options.title, address=options.address, progress=bar)
    say("\n".join(f"{one.name}: {one.seen.words}" for one in made))
    say(f"{options.output}: to look at it, python3 -m http.server --directory {options.output}")
    return 0


def make_manifest() -> App:
    app = make_app(
        "airgs-manifest", about="Look into a package, check it, compare it with the original, put it on a page."
    )
    for command, name in ((inspect, "inspect"), (validate, "validate"), (export_page, "export-page")):
        app.command(command, name=name)
    for place, words in (
        ("compare:compare", "Compare two scenes or packages: PSNR, SSIM, CIEDE2000, bytes, pictures."),
        ("compare:rungs", "Measure PSNR, SSIM and CIEDE2000 of every rung against the original."),
        ("set_view:set_view", "Change where viewers begin, which way is up, and named views, without encoding again."),
    ):
        app.command(f"airgs_codec.cli.{place}", name=place.partition(":")[2].replace("_", "-"), help=words)
    return app


def main(argv: Sequence[str] | None = None) -> int:
    """Do what the arguments say; returns the exit status."""
    return run_program("airgs-manifest", make_manifest(), argv)
