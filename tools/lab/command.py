"""The command: list the experiments, run one, print which command makes which figure.

    python -m tools.lab                     every experiment: its name, its question, how long it takes
    python -m tools.lab NAME … [-o FOLDER]  run one; its page, pictures, CSV and JSON go to FOLDER
    python -m tools.lab figures             which command makes which figure of which document

What was measured stays in FOLDER/work, so that a run that was interrupted goes on.
"""

from __future__ import annotations

import importlib
import shlex
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from airgs_codec._report import require_matplotlib, table
from airgs_codec._settings import setting
from airgs_codec.cli.options import make_app, run_program, takes
from airgs_codec.cli.terminal import Bar  # before all that loads numba
from tools.lab.experiments import EXPERIMENTS, FIGURES, Experiment
from tools.lab.page import Made, Page, text_of, update, write_page
from tools.lab.results import Results
from tools.lab.timing import machine

OUTPUT = Path("build") / "lab"
PROGRAM = "python -m tools.lab"


@dataclass(frozen=True, slots=True, eq=False)
class Lab:
    """Where an experiment works."""

    folder: Path  # of what it gives; it is there
    results: Results
    progress: Bar
    keep: Callable[[Page], object] = lambda page: None  # writes a page that is not finished, in case it never will be

    def tell(self, line: str) -> None:
        """Say on stderr how far it is."""
        print(line, file=sys.stderr, flush=True)

    @staticmethod
    def at(folder: Path, quiet: bool = False) -> Lab:
        """One that works in a folder, which is made."""
        folder.mkdir(parents=True, exist_ok=True)
        bar = Bar(quiet)
        return Lab(folder, Results.at(folder / "work", bar), bar)


@dataclass(frozen=True, slots=True)
class Output:
    """Options of every experiment."""

    output: Path | None = setting(
        None, f"folder of the page, its pictures and figures (default: {OUTPUT}/NAME)", short="-o", metavar="FOLDER"
    )
    update: Path | None = setting(None, "page to put the page into, too, between its marks", metavar="PAGE")


def main(argv: Sequence[str] | None = None) -> int:
    """Do what the arguments say; gives the exit status."""
    words = list(sys.argv[1:] if argv is None else argv)
    if not words:
        print(*(f"{one.name:<16} {one.question} ({one.takes})" for one in EXPERIMENTS), sep="\n")
        return 0
    app = make_app(PROGRAM, about=__doc__)
    app.command(_figures, name="figures")
    for one in EXPERIMENTS:
        if one.name == words[0]:  # it alone is loaded
            app.command(_command(one, words), name=one.name)
        else:
            app.command(f"{one.module}:run", name=one.name, help=f"{one.question} ({one.takes})")
    return run_program(f"lab {words[0]}", app, words)


def _figures() -> int:
    """Print which command makes which figure of which document."""
    head = ["file", "document", "command"]
    print(*table(head, [[one.file, one.document, one.command] for one in FIGURES]), sep="\n")
    return 0


def _command(experiment: Experiment, words: Sequence[str]) -> Callable[..., int]:
    """What runs an experiment, prints and writes its page; the status is 1 where it found what must not be."""
    module = importlib.import_module(experiment.module)

    def command(options: Any, output: Output) -> int:
        require_matplotlib("a page")
        folder, begun = output.output or OUTPUT / experiment.name, time.perf_counter()

        def write(page: Page) -> Made:
            took = time.perf_counter() - begun
            made = Made(experiment.name, experiment.question, f"{PROGRAM} {shlex.join(words)}", machine(), took)
            write_page(page, made, folder)
            return made

        lab = replace(Lab.at(folder), keep=write)
        try:
            page = module.run(options, lab)
        finally:
            lab.progress.close()
        assert isinstance(page, Page)
        made = write(page)
        if output.update:
            update(output.update, page, made)
        print(f"{text_of(page)}\n\n{folder}, {made.seconds:.0f} s; {made.machine}")
        return int(page.failed)

    command.__doc__ = f"{experiment.question}\n\n{module.__doc__}"
    return takes(module.Options, Output)(command)
