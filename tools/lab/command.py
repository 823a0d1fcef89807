"""The command: list the experiments, run one, print which command makes which figure.

    python -m tools.lab                     every experiment: its name, its question, how long it takes
    python -m tools.lab NAME … [-o FOLDER]  run one; its page, pictures, CSV and JSON go to FOLDER
    python -m tools.lab figures             which command makes which figure of which document

What was measured stays in FOLDER/work, so that a run that was interrupted goes on.
"""

from __future__ import annotations

import argparse
import importlib
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from airgs_codec._report import require_matplotlib, table
from airgs_codec.cli.common import Bar, run_command  # before all that loads numba
from tools.lab.experiments import EXPERIMENTS, FIGURES, Experiment
from tools.lab.options import add_options, read_options
from tools.lab.page import Made, Page, text_of, update, write_page
from tools.lab.results import Results
from tools.lab.timing import machine, seconds_of

OUTPUT = Path("build") / "lab"


@dataclass(frozen=True, slots=True, eq=False)
class Lab:
    """Where an experiment works."""

    folder: Path  # of what it gives; it is there
    results: Results
    progress: Bar

    def tell(self, line: str) -> None:
        """Say on stderr how far it is."""
        print(line, file=sys.stderr, flush=True)

    @staticmethod
    def at(folder: Path, quiet: bool = False) -> Lab:
        """One that works in a folder, which is made."""
        folder.mkdir(parents=True, exist_ok=True)
        bar = Bar(quiet)
        return Lab(folder, Results.at(folder / "work", bar), bar)


def main(argv: Sequence[str] | None = None) -> int:
    """Do what the arguments say; gives the exit status."""
    words = list(sys.argv[1:] if argv is None else argv)
    args = _parser(words[0] if words else "").parse_args(words)
    if args.name == "figures":
        head = ["file", "document", "command"]
        print(*table(head, [[one.file, one.document, one.command] for one in FIGURES]), sep="\n")
    elif args.name is None:
        print(*(f"{one.name:<16} {one.question} ({one.takes})" for one in EXPERIMENTS), sep="\n")
    else:
        return run_command(f"lab {args.name}", lambda: run(_named(args.name), args, words))
    return 0


def run(experiment: Experiment, args: argparse.Namespace, words: Sequence[str]) -> int:
    """Run an experiment, print and write its page; the exit status is 1 where it found what must not be."""
    require_matplotlib("a page")
    module = importlib.import_module(experiment.module)
    lab = Lab.at(args.output or OUTPUT / experiment.name)
    try:
        took, page = seconds_of(lambda: module.run(read_options(module.Options, args), lab))
    finally:
        lab.progress.close()
    assert isinstance(page, Page)
    command = f"python -m tools.lab {shlex.join(words)}"
    made = Made(experiment.name, experiment.question, command, machine(), took.wall)
    write_page(page, made, lab.folder)
    if args.update:
        update(args.update, page, made)
    print(f"{text_of(page)}\n\n{lab.folder}, {took.wall:.0f} s; {made.machine}")
    return int(page.failed)


def _named(name: str) -> Experiment:
    return next(one for one in EXPERIMENTS if one.name == name)


def _parser(wanted: str) -> argparse.ArgumentParser:
    """The parser; only the experiment that is wanted is loaded, and its options with it."""
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(prog="python -m tools.lab", description=__doc__, formatter_class=raw)
    names = parser.add_subparsers(dest="name", metavar="NAME")
    names.add_parser("figures", help="which command makes which figure of which document")
    for one in EXPERIMENTS:
        module = importlib.import_module(one.module) if one.name == wanted else None
        words = f"{one.question}\n\n{module.__doc__}" if module else None
        own = names.add_parser(one.name, help=f"{one.question} ({one.takes})", description=words, formatter_class=raw)
        if module:
            add_options(own, module.Options)
            place = f"of the page, its pictures and figures (default: {OUTPUT / one.name})"
            own.add_argument("-o", "--output", type=Path, metavar="FOLDER", help=place)
            own.add_argument("--update", type=Path, metavar="PAGE", help="put the page between its marks in PAGE, too")
    return parser
