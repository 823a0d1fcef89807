"""Options of commands: fields of frozen dataclasses become parameters of cyclopts; what several commands share.

A field without a default is an argument by its place, and takes several values if it is a tuple. Any other field is
`--its-name`, without the unit that its name may end in. `--help` lists the everyday options, each by what its text says
before the first semicolon, `--help-all` all options in full.
"""

from __future__ import annotations

import difflib
import importlib.util
import inspect
import re
import sys
import tempfile
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypedDict, get_args, get_origin, get_type_hints

from cyclopts import App, Group, Parameter, exceptions

from airgs_codec import __version__
from airgs_codec._report import require_matplotlib
from airgs_codec._settings import MOST, computed_setting, default_of, setting
from airgs_codec.cli.terminal import Bar, run_command, warn
from airgs_codec.errors import AirgsError, ConfigError
from airgs_codec.package.region import parse_up
from airgs_codec.places.whole import expect_folder_name
from airgs_codec.scene.beside import exact_number
from airgs_codec.scene.beside import frame_rate as rate_of

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from airgs_codec.jobs.work import Work
    from airgs_codec.progress import Progress
    from airgs_codec.scene.sequence import GaussianSequence

Given = dict[str, Any]  # settings that were given, by name

ALL = "--help-all"
ARGUMENTS, COMMANDS = Group("Arguments", sort_key=0), Group("Commands", sort_key=0)
EVERYDAY = Group("Options", sort_key=1)
WIDTH, COLUMN = 100, 26  # of help: characters in a line at most, and those that names of options may take
UNITS = {"_s": "S", "_db": "DB"}  # endings of names: their words in help
KINDS = {bool: "no value", int: "a whole number", float: "a number", Fraction: "a number or a fraction"}
PARAMETER = ("alias", "allow_leading_hyphen", "choices", "help", "metavar", "name")  # what cyclopts takes as it is

PACKAGE = "a package: its folder, or its address, s3://, gs:// or az://"
BUCKET = "s3://, gs://, az:// and a prefix"
FRAMES = "frames A to B - 1, or one frame"
DEVICES = ("auto", "cpu", "cuda")
FORMS = "; docs/encoding.md lists the forms of cameras"
CUDA = "; cuda needs a GPU and the cuda extra, auto takes it where it can"


def read_rate(text: str) -> Fraction:
    """Returns frames a second. Raises ValueError for what is no number, SceneError for what is no rate."""
    return rate_of("frames a second", exact_number(text))


RATE: Given = {"read": read_rate, "metavar": "FPS"}  # of options that are one
AXIS: Given = {"read": parse_up, "metavar": "AXIS", "allow_leading_hyphen": True}


def given(settings: type, topic: str, everyday: Collection[str] = (), name: str = "*") -> Any:
    """Returns a field for what is given of `settings`, by name; those that are not `everyday` are below `topic`.

    `name`: what stands before the dot in their options; *: nothing. Settings within settings are no options.
    """
    return computed_setting(dict, "", settings=settings, topic=topic, everyday=everyday, name=name)


def takes(*options: type) -> Callable[[Callable[..., int]], Callable[..., int]]:
    """Returns a decorator of commands, functions of these dataclasses, whose fields become the command's parameters."""

    def decorate(command: Callable[..., int]) -> Callable[..., int]:
        parameters = [parameter for one in options for parameter in _parameters(one)]
        signature = inspect.Signature(sorted(parameters, key=lambda parameter: parameter.kind))

        def run(*positional: Any, **named: Any) -> int:
            values = signature.bind(*positional, **named).arguments
            own = [{field.name for field in fields(one)} & values.keys() for one in options]
            made = (one(**{name: values[name] for name in names}) for one, names in zip(options, own, strict=True))
            return command(*made)

        run.__doc__ = command.__doc__
        run.__signature__ = signature  # type: ignore[attr-defined]
        return run

    return decorate


def _parameters(options: type) -> Iterator[inspect.Parameter]:
    hints = get_type_hints(options)
    own = inspect.get_annotations(options)
    for field in sorted(fields(options), key=lambda field: field.name not in own):
        more, hint = field.metadata, hints[field.name]
        kind: Any = inspect.Parameter.KEYWORD_ONLY
        default = inspect.Parameter.empty if default_of(field) is MISSING else None
        if "settings" in more:
            hint = Annotated[_given(more["settings"], more["topic"], more["everyday"]), Parameter(name=more["name"])]
        elif default is None or "alias" in more:
            hint = _option(field, hint, default_of(field), more.get("topic"))
        else:
            several = get_origin(hint) is tuple
            kind = inspect.Parameter.VAR_POSITIONAL if several else inspect.Parameter.POSITIONAL_ONLY
            name = more.get("metavar", field.name.upper())
            words = Parameter(name=name, help=more["help"], group=ARGUMENTS, required=True)
            hint = Annotated[get_args(hint)[0] if several else hint, words]
        yield inspect.Parameter(field.name, kind, default=default, annotation=hint)


def _given(settings: type, topic: str, everyday: Collection[str]) -> Any:
    hints, defaults = get_type_hints(settings), settings()
    entries = {
        field.name: _option(field, hints[field.name], value, None if field.name in everyday else topic)
        for field in fields(settings)
        if not is_dataclass(value := getattr(defaults, field.name)) and field.metadata.get("option", True)
    }
    return TypedDict(settings.__name__, entries, total=False)  # type: ignore[operator]


def _option(field: Field[Any], hint: Any, value: Any, topic: str | None) -> Any:
    """Returns the type of an option of the default `value`, with what cyclopts has to know of it."""
    more = field.metadata
    native = {name: more[name] for name in PARAMETER if name in more}
    whole = int in (hint, *get_args(hint)) and get_origin(hint) is not tuple
    read = more.get("read") or (partial(_whole, least=more.get("least", -MOST)) if whole else None)
    if unit := next((words for ending, words in UNITS.items() if field.name.endswith(ending)), ""):
        native["metavar"] = unit
    if len(choices := "|".join(more.get("choices", ()))) in range(1, COLUMN):
        native = {"metavar": choices, "show_choices": False} | native
    parameter = Parameter(
        **native,
        group=Group(topic, sort_key=5) if topic else EVERYDAY,
        converter=_converter(read, _expected(hint)) if read else None,
        negative=() if value is False else None,
        consume_multiple=get_origin(hint) is tuple and not read,
        show_default=_default_words(more.get("default", value)),
    )
    return Annotated[str if "read" in more else hint, parameter]


def _whole(text: str, least: int) -> int:
    """Returns a whole number, where cyclopts would round. Raises ValueError, ConfigError for one below `least`."""
    value = int(text)
    if value < least:
        raise ConfigError(f"expected {least} or more, got {value}")
    if value >= MOST:
        raise ValueError
    return value


def _converter(read: Callable[[str], Any], expected: str) -> Callable[[Any, Sequence[Any]], Any]:
    def convert(_: Any, tokens: Sequence[Any]) -> Any:
        try:
            return read(tokens[0].value)
        except AirgsError as error:
            raise ValueError(str(error)) from error
        except (ValueError, ArithmeticError) as error:
            raise ValueError(f"expected {expected}, got {tokens[0].value!r}") from error

    return convert


def _expected(hint: Any) -> str:
    if get_origin(hint) is Literal:
        return "one of " + ", ".join(map(str, get_args(hint)))
    return next((KINDS[kind] for kind in (hint, *get_args(hint)) if kind in KINDS), "a value")


def _default_words(value: Any) -> str | bool:
    if value in (None, "", ()) or value is False or value is MISSING:
        return False
    several = value if isinstance(value, tuple) else (value,)
    return "on" if value is True else " ".join(f"{one:g}" if isinstance(one, float) else str(one) for one in several)


def option_name(name: str) -> str:
    """Returns the name of a field's option, as --player.buffer has it last: dashes, no unit."""
    unit = next((unit for unit in UNITS if name.endswith(unit)), "")
    return name.removesuffix(unit).replace("_", "-")


def make_app(name: str, command: Callable[..., int] | None = None, about: str | None = None) -> App:
    """Returns the program `name`, which does `command`; without one its commands are added to it."""
    app = App(
        name=name,
        help=about,
        version=__version__,
        help_flags="--help",
        help_format="plaintext",
        result_action="return_value",
        print_error=False,
        exit_on_error=False,
        group_arguments=ARGUMENTS,
        group_parameters=EVERYDAY,
        group_commands=COMMANDS,
        default_parameter=Parameter(negative_iterable=(), name_transform=option_name),
        help_epilogue=f"{ALL} lists every option, --version says which version this is.",
        suppress_keyboard_interrupt=False,
    )
    if command is not None:
        app.default(command)
    return app


def run_program(name: str, program: App | Callable[..., int], argv: Sequence[str] | None) -> int:
    """Returns the exit status of a program or its one command, which `run_command` runs.

    Arguments that it does not take are one line on stderr and 2.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    app = program if isinstance(program, App) else make_app(name, program)
    return run_command(name, lambda: _run(app, words))


def _run(app: App, words: list[str]) -> int:
    if {ALL, "--help"} & set(words):
        app.help_formatter = _help(everything=ALL in words)
        words = [*(word for word in words[:1] if word in app), "--help"]
    try:
        if not words and app.default_command is None:
            raise exceptions.UnknownCommandError(app=app)
        return app(words) or 0
    except exceptions.CycloptsError as error:
        raise ConfigError(refusal(error)) from error
    except ConfigError as error:  # an argument of the library has the name under which it was given here
        argument, end, rest = re.split("([ :])", f"{error}:", maxsplit=1)
        option = f"--{option_name(argument)}"
        if option in (word.partition("=")[0] for word in words):
            error.args = ("".join([option, end, rest])[:-1],)
        raise


def _help(everything: bool) -> Any:
    """Returns what prints help in two columns without boxes; unless it is `everything`, of everyday options alone."""
    from cyclopts.help import ColumnSpec, DefaultFormatter, DescriptionRenderer, NameRenderer, PanelSpec
    from rich.box import SIMPLE

    shown = {group.name for group in (ARGUMENTS, COMMANDS, EVERYDAY)}

    def describe(entry: Any) -> Any:
        words = str(entry.description.primary_renderable)
        return DescriptionRenderer()(entry.copy(description=words if everything else words.partition(";")[0]))

    class Columns(DefaultFormatter):
        def __call__(self, console: Any, options: Any, panel: Any) -> None:
            entries = [entry for entry in panel.entries if not {"--help", "--version"} & set(entry.names)]
            if entries and (everything or panel.title in shown):
                console.width = min(WIDTH, console.width)
                super().__call__(console, options, panel.copy(entries=entries))

    names = ColumnSpec(NameRenderer(COLUMN), style="cyclopts.name", width=COLUMN)
    columns = names, ColumnSpec(describe, overflow="fold")
    return Columns(panel_spec=PanelSpec(box=SIMPLE, padding=(0, 2)), column_specs=columns)


def refusal(error: exceptions.CycloptsError) -> str:
    """Returns what is wrong with arguments, in one line."""
    name = error.argument.name if error.argument else "an argument"
    match error:
        case exceptions.CoercionError(token=token) if token is not None:
            words = error.msg or f"expected {_expected(error.target_type)}, got {token.value!r}"
            return f"argument {token.keyword or name}: {words}"
        case exceptions.MissingArgumentError():
            missing = f"argument {error.keyword}: expected a value" if error.keyword else f"expected {name}"
            return f"{missing}, got none"
        case exceptions.RepeatArgumentError():
            return f"argument {error.token.keyword}: expected one value, got another one: {error.token.value!r}"
        case exceptions.UnknownOptionError():
            known = [name for argument in error.argument_collection for name in argument.names]
            word = error.token.keyword or error.token.value  # the one where it has a value, else the other
            close = [f" ({name}?)" for name in difflib.get_close_matches(word, known, 1)]
            return f"argument {word}: expected an option that there is{''.join(close)}; see {ALL}"
        case exceptions.UnknownCommandError():
            known = [name for name in error.app or () if not name.startswith("-")]
            return f"expected one of {', '.join(known)}, got {(error.unused_tokens or ['none'])[0]!r}"
        case exceptions.UnusedCliTokensError():
            return f"expected no further arguments, got {' '.join(error.unused_tokens or ())}"
    return " ".join(str(error).split())


def expect_one(**options: Any) -> None:
    """Raise ConfigError where more than one of these options was given."""
    given = [f"--{option_name(name)}" for name, value in options.items() if value is not None]
    if len(given) > 1:
        raise ConfigError(f"{given[1]}: expected one of these options, got {' and '.join(given)}")


def expect_names(option: str, names: Iterable[str], known: Collection[str]) -> None:
    """Raise ConfigError unless all of `names` are among `known`."""
    if unknown := [name for name in names if name not in known]:
        raise ConfigError(f"{option}: expected some of {', '.join(known)}, got {', '.join(unknown)}")


def parse_frames(text: str | None) -> tuple[int, int | None]:
    """First frame and the one after the last of A:B, A:, :B or a single number; None stands for the end.

    Without text, all frames. Raises ConfigError.
    """
    head, colon, tail = (text or ":").partition(":")
    try:
        start = int(head) if head else 0
        return start, (int(tail) if tail else None) if colon else start + 1
    except ValueError as error:
        raise ConfigError(f"--frames: expected A:B, got {text!r}") from error


def parse_range(text: str, frames: int) -> tuple[int, int]:
    """(start, stop) as `parse_frames` gives it, of a sequence of `frames`. Raises ConfigError."""
    start, stop = parse_frames(text)
    stop = frames if stop is None else stop
    if not 0 <= start < stop <= frames:
        raise ConfigError(f"--frames: expected A:B inside 0:{frames}, got {text!r}")
    return start, stop


@dataclass(frozen=True, kw_only=True)
class BakingOptions:
    """How `open_sequence` reads a clip; None: as the file says, or else the default of its format."""

    bake_fps: Fraction | None = setting(
        None,
        "frames a second that a clip of moving Gaussians is baked to",
        default="what the file says, else 30",
        topic="clips",
        **RATE,
    )
    duration: Fraction | None = setting(
        None,
        "length in seconds of a clip whose file states none: .splatv, Spacetime Gaussians .ply",
        default="5/3",
        read=exact_number,
        metavar="S",
        topic="clips",
    )

    def baking(self) -> dict[str, Any]:
        return {"bake_fps": self.bake_fps, "duration": self.duration}


@dataclass(frozen=True, kw_only=True)
class WorkOptions:
    """Who does the work (docs/farm.md): processes of this machine, or a Dask cluster."""

    jobs: int = setting(1, "processes that share the work", least=1)
    work: str | None = setting(
        None,
        "where finished jobs stay, so that a run that was cut off goes on; a folder that all workers see, or s3://, "
        "gs://, az:// and a prefix; who may write there decides what comes out; by default nothing stays",
        metavar="PLACE",
    )
    executor: str | None = setting(
        None,
        "a Dask cluster does the work: the one whose scheduler is at ADDRESS, or one of --jobs processes on this "
        "machine",
        metavar="dask[:ADDRESS]",
        topic="work",
    )

    def shared_by(self) -> str | None:
        """Returns the first of the options that is given; None where one process does everything by itself."""
        given = {"--jobs": self.jobs != 1, "--executor": self.executor, "--work": self.work}
        return next((name for name, value in given.items() if value), None)

    @contextmanager
    def opened(self, progress: Progress, needs: dict[str, float] | None = None) -> Iterator[Work]:
        """Give what the options ask for, until the block ends; `needs`: resources of a worker, as {"GPU": 1}.

        Raises ConfigError for options that cannot work.
        """
        from airgs_codec.jobs.work import Work

        with ExitStack() as stack:
            executor = self._executor(needs)
            if executor:
                stack.callback(executor.shutdown, cancel_futures=True)
            yield Work.of(executor, self.work, progress)

    def _executor(self, needs: dict[str, float] | None) -> Executor | None:
        from airgs_codec.jobs.executors import DaskCluster, Processes

        if self.executor is None:
            return Processes(self.jobs) if self.jobs > 1 else None
        name, _, address = self.executor.partition(":")
        if name != "dask" or self.executor == "dask:":
            raise ConfigError(f"--executor: expected dask or dask:ADDRESS, got {self.executor!r}")
        if importlib.util.find_spec("distributed") is None:
            raise ConfigError("--executor dask needs Dask: pip install 'airgs-codec[farm]'")
        return DaskCluster(address, self.jobs, needs)


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
    """Raise ConfigError where a report cannot be drawn, or a file is where its folder should be."""
    if folder:
        require_matplotlib("--report")
        expect_folder(folder)


def expect_folder(path: Path) -> None:
    """Raise ConfigError where no folder can be made or written, before the work begins."""
    expect_folder_name(path)
    there = next(place for place in (path.absolute(), *path.absolute().parents) if place.exists())
    if not there.is_dir():
        raise ConfigError(f"{there}: expected a folder, got a file")
    try:
        tempfile.TemporaryFile(dir=there).close()
    except OSError as error:
        raise ConfigError(f"{path}: expected a folder that can be written: {error.strerror}") from error
