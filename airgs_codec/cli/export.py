"""airgs-manifest export-page: a folder that any static host serves, with the player and packages."""

from __future__ import annotations

import argparse
from pathlib import Path

from airgs_codec.cli.common import PACKAGE, Bar
from airgs_codec.serve.export import export_page


def add_export(parser: argparse.ArgumentParser) -> None:
    """The arguments of the command."""
    parser.add_argument("packages", nargs="+", metavar="PACKAGE", help=PACKAGE)
    out = "folder to write: new, empty, or one that this command wrote"
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="SITE", help=out)
    parser.add_argument("--title", metavar="TEXT", help="of the page (default: the package's name)")
    where = "where the folder will be on the web: previews of links need it to show the picture"
    parser.add_argument("--address", default="", metavar="URL", help=where)


def export(args: argparse.Namespace) -> int:
    """Write the folder and say what is in it."""
    bar = Bar()
    try:
        made = export_page(args.packages, args.output, title=args.title, address=args.address, progress=bar)
    finally:
        bar.close()
    for package in made:
        print(f"{package.name}: {package.words}")
    print(f"{args.output}: to look at it, python3 -m http.server --directory {args.output}")
    return 0
