"""Options of commands: fields of dataclasses, as `_settings.setting` describes them, become parameters of cyclopts.

A field without a default is an argument by its place. Any other is `--its-name`, without the unit that its name may end
in. `--help` lists the everyday options, `--help-all` all of them, by topic.
"""

from __future__ import annotations

import importlib.util
import re
import sys
import tempfile
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypedDict, TypeVar, dataclass_transform, get_type_hints

from cyclopts import App, CycloptsError, Group, Parameter
from cyclopts.validators import Number

from airgs_codec import __version__
from airgs_codec._settings import default_of, setting
from airgs_codec.cli.terminal import Bar, run_command, warn
from airgs_codec.errors import ConfigError
from airgs_codec.package.region import parse_up
from airgs_codec.places.whole import expect_folder_name
from airgs_codec.scene.beside import exact_number, frame_rate

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from airgs_codec.jobs.work import Work
    from airgs_codec.progress import Progress
    from airgs_codec.scene.sequence import GaussianSequence

Given = dict[str, Any]  # settings that were given, by name
Options = TypeVar("Options")

ALL = "--help-all"
ARGUMENTS = Group("Arguments", sort_key=0)
COMMON = Group("Options", sort_key=1)
PARAMETER = ("alias", "allow_leading_hyphen", "choices", "help", "metavar", "name", "validator")  # of cyclopts

PACKAGE = "a package: its folder, or its address, s3://, gs:// or az://"
BUCKET = "s3://, gs://, az:// and a prefix"
FRAMES_HELP = "frames A to B - 1, or one frame"
FORMS = "; docs/encoding.md lists the forms of cameras"
EXECUTOR = "a Dask cluster does the work: one with its scheduler at ADDRESS, or one of --jobs processes on this machine"
EXAMPLES = """\
airgs-encode frames/ -o scene.airgs
airgs-encode frames/ --views transforms.json --target-psnr 40
airgs-encode head.ply --preset fast --report report/
airgs-decode scene.airgs -o frames/
airgs-decode scene.airgs -o first.spz --frames 0
airgs-decode scene.airgs -o small/ --keyframe-quality Q1 --level L2
airgs-train views/ -o model/
airgs-train views/ --frames 0:30 --effort quick --report report/
airgs-train views/ -o model/ --resume
airgs-play scene.airgs --trace const:8
airgs-play scene.airgs --trace trace.csv --policy bola --video film.mp4
airgs-play scene.airgs --compare --traces traces/
airgs-serve manifests/showcase/head.airgs --open
airgs-serve frames/
airgs-serve packages/ --host 0.0.0.0 --certificate chain.pem --key key.pem
airgs-manifest inspect scene.airgs
airgs-manifest inspect scene.airgs --plot rungs.png
airgs-manifest inspect https://example.org/scene.airgs --json
airgs-manifest validate scene.airgs
airgs-manifest validate scene.airgs --against frames/
airgs-manifest validate s3://bucket/scene.airgs --json
airgs-manifest set-view scene.airgs --up=-y
airgs-manifest set-view scene.airgs --position 0,1,3 --look-at 0,1,0
airgs-manifest set-view a.airgs --position 2,1,0 --look-at 0,1,0 --name left
airgs-manifest export-page scene.airgs -o site/
airgs-manifest export-page head.airgs fox.airgs -o site/ --title Gallery
airgs-manifest export-page a.airgs -o site/ --address https://example.org/
airgs-manifest compare frames/ scene.airgs
airgs-manifest compare frames/ scene.airgs --rung Q1+L1 -o pictures/
airgs-manifest compare a.ply b.spz --json
airgs-manifest rungs scene.airgs frames/
airgs-manifest rungs scene.airgs frames/ --every 10 --draws 20
airgs-manifest rungs scene.airgs frames/ --views held_out.json
"""
CUDA = "; cuda needs a GPU and the cuda extra, auto takes it where it can"


def read_fraction(text: str) -> Fraction:
    """Return 30, 29.97 or 30000/1001 as a fraction. Raises ConfigError for anything else."""
    try:
        return exact_number(text)
    except (ValueError, ArithmeticError) as error:
        raise ConfigError(f"expected a number or a fraction, got {text!r}") from error


def read_three(kind: type, words: str) -> Callable[[str], tuple[Any, ...]]:
    """Return what reads three numbers of a kind, with commas; it raises ConfigError, with `words`, for other text."""

    def read(text: str) -> tuple[Any, ...]:
        try:
            first, second, third = map(kind, text.split(","))
        except ValueError as error:
            raise ConfigError(f"expected {words}, got {text!r}") from error
        return first, second, third

    return read


FPS: Given = {"read": lambda text: frame_rate("frames a second", read_fraction(text)), "metavar": "FPS"}
CLIP_FPS, CLIP_SECONDS = FPS | {"topic": "clips"}, {"read": read_fraction, "metavar": "S", "topic": "clips"}
DEVICE: Given = {"choices": ("auto", "cpu", "cuda")}
AXIS: Given = {"read": parse_up, "metavar": "AXIS", "allow_leading_hyphen": True}


def given(settings: type, topic: str, everyday: Collection[str] = (), name: str = "*") -> Any:
    """Return a field for those of `settings` that are given, by name; those not `everyday` are listed below `topic`.

    `name`: what stands before the dot in their options; *: nothing.
    """
    return field(default_factory=dict, metadata={"settings": (settings, topic, everyday), "name": name})


@dataclass_transform(kw_only_default=True, frozen_default=True)
def as_options(kind: type[Options]) -> type[Options]:
    """Return `kind` as a dataclass, if it is none, with annotations that make its fields parameters of a command."""
    kind = kind if is_dataclass(kind) else dataclass(frozen=True, kw_only=True)(kind)
    hints = get_type_hints(kind, include_extras=True)
    for one in fields(kind):  # type: ignore[arg-type]
        if "settings" in one.metadata:
            hints[one.name] = Annotated[_given(*one.metadata["settings"]), Parameter(name=one.metadata["name"])]
        elif "help" in one.metadata:
            hints[one.name] = _option(one, hints[one.name], one.metadata.get("topic"))
    kind.__annotations__ = kind.__init__.__annotations__ = hints
    return Parameter(name="*")(kind)


def _given(settings: type, topic: str, everyday: Collection[str]) -> Any:
    hints, options = get_type_hints(settings), [one for one in fields(settings) if one.metadata.get("option", True)]
    entries = {one.name: _option(one, hints[one.name], None if one.name in everyday else topic) for one in options}
    return TypedDict(settings.__name__, entries, total=False)  # type: ignore[operator]


def _option(one: Field[Any], hint: Any, topic: str | None) -> Any:
    """Return the type of an option with what cyclopts has to know of it."""
    more, default = one.metadata, default_of(one)
    read = more.get("read") or (int if hint in (int, int | None) else None)  # cyclopts rounds numbers to whole ones
    shown = more.get("default", default)
    parameter = Parameter(
        **{name: more[name] for name in PARAMETER if name in more},
        group=ARGUMENTS if default is MISSING else Group(topic, sort_key=5) if topic else COMMON,
        converter=read and (lambda _, tokens: read(tokens[0].value)),
        negative=None if default is True or hint == (bool | None) else (),
        show_default=False if shown in (None, MISSING, "", ()) or shown is False else str(shown),
    )
    return Annotated[str if "read" in more else hint, parameter]


def option_name(name: str) -> str:
    """Return the name of a field's option, as --player.buffer has it last: dashes, no unit."""
    return re.sub("_(s|db)$", "", name).replace("_", "-")


def epilogue(words: str) -> str:
    """Return what the help of a program or a subcommand ends with: three examples, if there are any."""
    said = f"{ALL} lists every option, --version says which version this is."
    found = [line for line in EXAMPLES.splitlines() if line.startswith(f"{words} ")]
    examples = found[:: len(found) // 3 or 1]  # of a program with subcommands those of some
    return "\n  ".join([f"{said}\n\nExamples:", *examples]) if examples else said


def make_app(name: str, command: Callable[..., int] | None = None, about: str | None = None) -> App:
    """Return the program `name`, which does `command`; without one its commands are added to it."""
    how: Given = {"print_error": False, "exit_on_error": False, "suppress_keyboard_interrupt": False}
    how |= {"result_action": "return_value", "help_flags": "--help", "help_format": "plaintext"}
    how["default_parameter"] = Parameter(consume_multiple=True, name_transform=option_name)
    how["help_epilogue"] = epilogue(name)
    commands = Group("Commands", sort_key=0, show=command is None)
    groups: Given = {"group_arguments": ARGUMENTS, "group_commands": commands}
    app = App(name=name, help=about, version=__version__, **groups, **how)
    if command is not None:
        app.default(command)
    return app


def run_program(name: str, program: App | Callable[..., int], argv: Sequence[str] | None = None) -> int:
    """Return the exit status of a program or its one command, which `run_command` runs.

    Arguments that it does not take are one line on stderr and 2.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    app = program if isinstance(program, App) else make_app(name, program)
    return run_command(name, lambda: _run(app, words))


def _run(app: App, words: list[str]) -> int:
    app.help_formatter = _help(everything=ALL in words)
    try:
        return app(["--help" if word == ALL else word for word in words]) or 0
    except CycloptsError as error:
        raise ConfigError(str(error)) from error


def _help(everything: bool) -> Any:
    """Return a formatter of help in two columns without boxes, of all options or only of those without a topic."""
    from cyclopts.help import DefaultFormatter, PanelSpec
    from rich.box import SIMPLE

    class AlignedColumns(DefaultFormatter):
        def __call__(self, console: Any, options: Any, panel: Any) -> None:
            if everything or panel.title in ("Commands", ARGUMENTS.name, COMMON.name):
                super().__call__(console, options, panel)

    return AlignedColumns(panel_spec=PanelSpec(box=SIMPLE))


def parse_frames(text: str | None) -> tuple[int, int | None]:
    """Return the first frame and the one after the last of A:B, A:, :B or a number; None stands for the end.

    Without text, all frames. Raises ConfigError.
    """
    head, colon, tail = (text or ":").partition(":")
    try:
        start = int(head or 0)
        return start, (int(tail) if tail else None) if colon else start + 1
    except ValueError as error:
        raise ConfigError(f"--frames: expected A:B, got {text!r}") from error


def parse_range(text: str, frames: int) -> tuple[int, int]:
    """Return (start, stop) as `parse_frames` does, of a sequence of `frames`. Raises ConfigError."""
    start, stop = parse_frames(text)
    stop = frames if stop is None else stop
    if not 0 <= start < stop <= frames:
        raise ConfigError(f"--frames: expected A:B inside 0:{frames}, got {text!r}")
    return start, stop


@as_options
class BakingOptions:
    """How `open_sequence` reads a clip; None: as the file says, or else the default of its format."""

    bake_fps: Fraction | None = setting(None, "frames a second of a clip", default="the file's, else 30", **CLIP_FPS)
    duration: Fraction | None = setting(None, "seconds of a clip whose file states none", default="5/3", **CLIP_SECONDS)


@as_options
class WorkOptions:
    """Who does the work (docs/farm.md): processes of this machine, or a Dask cluster."""

    jobs: int = setting(1, "processes that share the work", validator=Number(gte=1))
    work: str | None = setting(None, f"where results of a run stay to go on from: folder, {BUCKET}", metavar="PLACE")
    executor: str | None = setting(None, EXECUTOR, metavar="dask[:ADDRESS]", topic="work")

    def shared_by(self) -> str | None:
        """Return the first of the options that is given; None where one process does everything by itself."""
        given = {"--jobs": self.jobs != 1, "--executor": self.executor, "--work": self.work}
        return next((name for name, value in given.items() if value), None)

    @contextmanager
    def opened(self, progress: Progress, needs: dict[str, float] | None = None) -> Iterator[Work]:
        """Yield an executor and a store as the options ask; `needs`: resources of a worker, as {"GPU": 1}.

        Raises ConfigError for options that cannot work.
        """
        from airgs_codec.jobs.executors import DaskCluster, Processes
        from airgs_codec.jobs.work import Work

        executor: Executor | None = Processes(self.jobs) if self.jobs > 1 and not self.executor else None
        if self.executor:
            name, _, address = self.executor.partition(":")
            if name != "dask":
                raise ConfigError(f"--executor: expected dask or dask:ADDRESS, got {self.executor!r}")
            if importlib.util.find_spec("distributed") is None:
                raise ConfigError("--executor dask needs Dask: pip install 'airgs-codec[farm]'")
            executor = DaskCluster(address, self.jobs, needs)
        try:
            yield Work.of(executor, self.work, progress)
        finally:
            if executor:
                executor.shutdown(cancel_futures=True)


def open_frames(place: str, *, quiet: bool = False, **how: Any) -> GaussianSequence:
    """Return the sequence at a place; copying it from an address shows a bar, and a line of what was copied.

    `how`: arguments of `open_sequence`, which says what is raised.
    """
    from airgs_codec.scene.sequence import open_sequence

    with Bar(quiet) as bar:
        sequence = open_sequence(place, progress=bar, **how)
    if sequence.copied and not quiet:
        warn(str(sequence.copied))
    return sequence


def expect_report(folder: Path | None) -> None:
    """Raise ConfigError where a file is where the folder of a report should be."""
    if folder:
        expect_folder(folder)


def expect_folder(path: Path) -> None:
    """Raise ConfigError where no folder can be made or written, before the work begins."""
    expect_folder_name(path)
    existing = next(place for place in (path.absolute(), *path.absolute().parents) if place.exists())
    try:
        tempfile.TemporaryFile(dir=existing).close()
    except OSError as error:
        raise ConfigError(f"{path}: expected a folder that can be written: {error.strerror}") from error
