"""The command: list the experiments, run one, print which command makes which figure.

    python -m tools.lab                     every experiment: its name, its question, how long it takes
    python -m tools.lab NAME … [-o FOLDER]  run one; its page, pictures and JSON go to FOLDER
    python -m tools.lab publish DATA        run all that documents show, in a folder of scenes (hours)

What was measured stays in FOLDER/work, so that a run that was interrupted goes on.
"""

from __future__ import annotations

import importlib
import os
import shlex
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import MISSING, dataclass, fields, replace
from pathlib import Path
from typing import Any

from airgs_codec._settings import default_of, required, setting
from airgs_codec.cli.options import as_options, make_app, run_program
from airgs_codec.cli.terminal import Bar  # before all that loads numba
from airgs_codec.errors import ConfigError
from airgs_codec.package.tables import VERSION
from tools.lab.experiments import EXPERIMENTS, MEASUREMENTS, Experiment, Measurement
from tools.lab.page import Made, Page, text_of, write_page
from tools.lab.published import FIGURES, REPOSITORY, publish, today_and_commit
from tools.lab.results import Results
from tools.lab.timing import machine

OUTPUT = Path("build") / "lab"
PROGRAM = "python -m tools.lab"
NAMES = tuple(one.name for one in MEASUREMENTS)


@dataclass(frozen=True, slots=True, eq=False)
class Lab:
    folder: Path  # of what it gives; it is there
    results: Results
    progress: Bar
    keep: Callable[[Page], object] = lambda page: None  # writes a page that is not finished, in case it never will be

    def tell(self, line: str) -> None:
        print(line, file=sys.stderr, flush=True)

    @staticmethod
    def at(folder: Path, quiet: bool = False) -> Lab:
        folder.mkdir(parents=True, exist_ok=True)
        bar = Bar(quiet)
        return Lab(folder, Results.at(folder / "work", bar), bar)


@as_options
@dataclass(frozen=True, slots=True)
class Output:
    output: Path | None = setting(
        None, f"folder of the page, its pictures and figures (default: {OUTPUT}/NAME)", alias="-o", metavar="FOLDER"
    )
    publish: str = setting("", "put the page and its figures into docs/results, as this measurement", choices=NAMES)


@as_options
@dataclass(frozen=True, slots=True)
class Published:
    data: Path = required("a folder of scenes, by the names that commands of documents give them")
    only: tuple[str, ...] = setting(NAMES, "of these measurements", choices=NAMES)


def main(argv: Sequence[str] | None = None) -> int:
    words = list(sys.argv[1:] if argv is None else argv)
    if not words:
        print(*(f"{one.name:<16} {one.question} ({one.takes})" for one in EXPERIMENTS), sep="\n")
        return 0
    app = make_app(PROGRAM, about=__doc__)
    app.command(_publish, name="publish")
    for one in EXPERIMENTS:
        if one.name == words[0]:  # it alone is loaded
            app.command(_command(one, words), name=one.name)
        else:
            app.command(f"{one.module}:run", name=one.name, help=f"{one.question} ({one.takes})")
    return run_program(f"lab {words[0]}", app, words)


def run_alone(one: Experiment, argv: Sequence[str] | None = None) -> int:
    """Run what is no experiment, but has options, a page and a folder as experiments have: `python -m MODULE`."""
    words = list(sys.argv[1:] if argv is None else argv)
    return run_program(one.name, _command(one, words), words)


def _publish(options: Published) -> int:
    """Run what documents show, and put its pages and figures into docs/results; the status is 1 where some failed."""
    failed = []
    for one in (one for one in MEASUREMENTS if one.name in options.only):
        words = [*shlex.split(one.words), "--publish", one.name, "-o", str((OUTPUT / one.name).absolute())]
        call = [sys.executable, "-m", "tools.lab", *words]
        if subprocess.run(call, cwd=options.data, env=os.environ | {"PYTHONPATH": str(REPOSITORY)}).returncode:
            failed.append(one.name)
    print(f"failed: {', '.join(failed)}" if failed else f"{FIGURES}: {len(options.only)} measurements")
    return int(bool(failed))


def measurement_of(name: str, words: Sequence[str]) -> Measurement:
    """The measurement of a name. Raises ConfigError where its command is another."""
    found = next(one for one in MEASUREMENTS if one.name == name)
    asked = shlex.split(found.words)
    if list(words[: len(asked)]) != asked or not set(words[len(asked) :: 2]) <= {"--publish", "-o"}:
        raise ConfigError(f"--publish {name}: expected the command that documents show, {PROGRAM} {found.words}")
    return found


def _command(experiment: Experiment, words: Sequence[str]) -> Callable[..., int]:
    """What runs an experiment, prints and writes its page; the status is 1 where it found what must not be."""
    module = importlib.import_module(experiment.module)
    program = PROGRAM if experiment in EXPERIMENTS else f"python -m {experiment.module}"

    def command(options: Any, output: Output) -> int:
        folder, begun = output.output or OUTPUT / experiment.name, time.perf_counter()
        measurement = measurement_of(output.publish, words) if output.publish else None
        said = f"{program} {measurement.words if measurement else shlex.join(words)}"

        def write(page: Page) -> Made:
            took = time.perf_counter() - begun
            made = Made(experiment.name, experiment.question, said, machine(), took, *today_and_commit(), VERSION)
            write_page(page, made, folder)
            return made

        lab = replace(Lab.at(folder), keep=write)
        try:
            page = module.run(options, lab)
        finally:
            lab.progress.close()
        assert isinstance(page, Page)
        made = write(page)
        if measurement:
            publish(measurement, page, replace(made, name=measurement.name), folder)
        print(f"{text_of(page)}\n\n{folder}, {made.seconds:.0f} s; {made.machine}")
        return int(page.failed)

    command.__doc__ = f"{experiment.question}\n\n{module.__doc__}"
    command.__annotations__ = {"options": as_options(module.Options), "output": Output}
    needed = any(default_of(one) is MISSING for one in fields(module.Options))
    command.__defaults__ = (Output(),) if needed else (module.Options(), Output())
    return command
