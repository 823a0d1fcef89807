"""From settings to options: frozen dataclasses, described as `airgs_codec._settings` says, for cyclopts to parse.

A field without a default is an argument by its place, and takes several values if it is a tuple. Any other field is
`--its-name`, without the unit that its name may end in. The fields of settings within settings have dotted names,
`--player.buffer`, unless they are those of the command itself. `--help` lists the everyday options, each by
what its text says before the first semicolon, `--help-all` all options in full.
"""

from __future__ import annotations

import difflib
import inspect
import re
import shutil
import sys
import textwrap
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypedDict, TypeVar, get_args, get_origin, get_type_hints

from cyclopts import App, Group, Parameter, exceptions

from airgs_codec import __version__
from airgs_codec._settings import applied, computed_setting, default_of, is_of
from airgs_codec.cli.terminal import run_command
from airgs_codec.errors import AirgsError, ConfigError

if TYPE_CHECKING:
    from cyclopts.help import HelpEntry, HelpPanel
    from rich.console import Console

Options = TypeVar("Options")
Given = dict[str, Any]  # settings that were given, by name; those of settings within them are such a dictionary again

ALL = "--help-all"
EMPTY: Any = inspect.Parameter.empty
EVERYDAY = Group("Options", sort_key=1)
ARGUMENTS = Group("Arguments", sort_key=0)
COMMANDS = Group("Commands", sort_key=0)
FLAGS = {"--help", "--version"}
DETAIL = re.compile(r"; .*?( \(default: [^()]*\))?$")  # of a help text: what follows the first semicolon
WIDTH, COLUMN = 100, 30  # of help: characters in a line at most, and before what options mean
UNITS = {"_s": "S", "_db": "DB"}  # endings of names: their words in help
KINDS: dict[Any, tuple[str, str]] = {  # words in help and in errors
    int: ("N", "a whole number"),
    float: ("X", "a number"),
    Fraction: ("X", "a number or a fraction"),
    Path: ("PATH", "a path"),
    bool: ("", "no value"),
}


@dataclass(frozen=True, slots=True)
class Nested:
    settings: type
    topic: str  # of those that are not among `everyday`
    everyday: Collection[str] | None = ()  # None: all are
    own: bool = False  # they are the command's own, their names without dots


def nested(settings: type, topic: str, everyday: Collection[str] | None = (), own: bool = False) -> Any:
    """Returns a field of options that is a dataclass of settings itself, made of its defaults and what was given."""
    return computed_setting(settings, "", nested=Nested(settings, topic, everyday, own))


def given(settings: type, topic: str, everyday: Collection[str] | None = (), own: bool = False) -> Any:
    """Returns a field for what was given of `settings` alone: a dictionary that `applied` takes."""
    return computed_setting(dict, "", nested=Nested(settings, topic, everyday, own))


def takes(*options: type) -> Callable[[Callable[..., int]], Callable[..., int]]:
    """Returns a decorator of commands, functions of these dataclasses, whose fields become the command's parameters."""

    def decorate(command: Callable[..., int]) -> Callable[..., int]:
        signature = inspect.Signature(_parameters(options))

        def run(*values: Any, **rest: Any) -> int:
            given = signature.bind(*values, **rest).arguments
            return command(*(_made(one, given) for one in options))

        run.__doc__ = command.__doc__
        run.__signature__ = signature  # type: ignore[attr-defined]
        return run

    return decorate


def _made(options: type, values: dict[str, Any]) -> Any:
    own = {one.name: values[one.name] for one in fields(options) if one.name in values}
    for one in fields(options):
        if one.name in own and "nested" in one.metadata and is_dataclass(default_of(one)):
            own[one.name] = applied(default_of(one), own[one.name])
    return options(**own)


def make_app(name: str, command: Callable[..., int] | None = None, about: str | None = None) -> App:
    """Returns the program `name`, which does `command`; without one its commands are added to it."""
    app = App(
        name=name,
        help=about,
        version=__version__,
        help_format="plaintext",
        result_action="return_value",
        print_error=False,
        exit_on_error=False,
        group_arguments=ARGUMENTS,
        group_parameters=EVERYDAY,
        group_commands=COMMANDS,
        default_parameter=Parameter(negative_iterable=(), show_default=False, show_choices=False),
        help_formatter=Columns(everything=False),
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
    if ALL in words:
        app.help_formatter = Columns(everything=True)
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


def expect_one(**options: Any) -> None:
    """Raise ConfigError where more than one of these options was given."""
    told = [f"--{name.replace('_', '-')}" for name, value in options.items() if value is not None]
    if len(told) > 1:
        raise ConfigError(f"{told[1]}: expected one of these options, got {' and '.join(told)}")


def expect_names(option: str, names: Iterable[str], known: Collection[str]) -> None:
    """Raise ConfigError unless all of `names` are among `known`."""
    if unknown := [name for name in names if name not in known]:
        raise ConfigError(f"{option}: expected some of {', '.join(known)}, got {', '.join(unknown)}")


def option_name(name: str) -> str:
    """Returns the name of a field's option, as --player.buffer has it last: dashes, no unit."""
    unit = next((unit for unit in UNITS if name.endswith(unit)), "")
    return name.removesuffix(unit).replace("_", "-")


def _parameters(options: Iterable[type]) -> list[inspect.Parameter]:
    """The parameters of a function that takes the fields of dataclasses, those by place first."""
    hints = {name: hint for one in options for name, hint in get_type_hints(one).items()}
    found = []
    for one in (one for every in options for one in fields(every)):
        hint, default = hints[one.name], EMPTY
        kind: Any = inspect.Parameter.KEYWORD_ONLY
        if default_of(one) is MISSING and "short" not in one.metadata:  # an argument by its place
            several = get_origin(hint) is tuple
            kind = inspect.Parameter.VAR_POSITIONAL if several else inspect.Parameter.POSITIONAL_ONLY
            name = one.metadata.get("metavar", one.name.upper())
            words = Parameter(name=name, help=one.metadata["help"], group=ARGUMENTS, required=True)
            hint = Annotated[get_args(hint)[0] if several else hint, words]
        elif nested := one.metadata.get("nested"):
            default = None
            words = Parameter(name="*") if nested.own else Parameter(name=option_name(one.name))
            hint = Annotated[_nested(nested, nested.settings()), words]
        else:
            default = EMPTY if default_of(one) is MISSING else None
            about = one.metadata["help"] + default_words(one.metadata.get("default", default_of(one)))
            hint = _annotated(one, hint, about, one.metadata.get("topic"))
        found.append(inspect.Parameter(one.name, kind, default=default, annotation=hint))
    return sorted(found, key=lambda one: one.kind)


def _nested(nested: Nested, values: Any, about: str = "") -> Any:
    """The type of a dictionary with some of the fields of settings, whose defaults are `values`."""
    hints = get_type_hints(nested.settings)
    entries = {}
    for one in (one for one in fields(nested.settings) if one.metadata.get("option", True)):
        value = getattr(values, one.name)
        words = one.metadata.get("help", about)
        everyday = nested.everyday is None or one.name in nested.everyday
        if is_dataclass(value):
            inner = Nested(type(value), nested.topic, None if everyday else ())
            entries[one.name] = Annotated[_nested(inner, value, words), Parameter(name=option_name(one.name))]
        else:
            words += default_words(one.metadata.get("default", value))
            entries[one.name] = _annotated(one, hints[one.name], words, None if everyday else nested.topic)
    return TypedDict(nested.settings.__name__, entries, total=False)  # type: ignore[operator]


def _annotated(one: Field[Any], hint: Any, about: str, topic: str | None) -> Any:
    """The type of an option, with what the library has to know of it."""
    told = one.metadata
    kind = next((kind for kind in get_args(hint) if NoneType in get_args(hint) and kind is not NoneType), hint)
    several = get_origin(kind) is tuple and "read" not in told
    unit = next((words for ending, words in UNITS.items() if one.name.endswith(ending)), "")
    choices = told.get("choices", ())
    read = told.get("read") or (int if kind is int else None)  # the library would round
    kind_words = KINDS.get(get_args(kind)[0] if several else kind, ("TEXT", ""))[0]
    name = told.get("name") or option_name(one.name)
    words = Parameter(
        name=(f"--{name}", told["short"]) if "short" in told else name,
        help=about,
        group=Group(topic, sort_key=5) if topic else EVERYDAY,
        metavar=told.get("metavar") or unit or "|".join(choices) or kind_words,
        converter=partial(_read, read, kind) if read else None,
        negative=None if kind is bool and default_of(one) is not False else (),
        consume_multiple=True if several else None,
        allow_leading_hyphen=told.get("signed", False),
    )
    if choices:
        return Annotated[Literal[tuple(choices)], words]
    return Annotated[str if "read" in told else kind, words]


def _read(read: Callable[[str], Any], kind: Any, _: Any, tokens: Sequence[Any]) -> Any:
    text = tokens[0].value
    try:
        value = read(text)
        if kind is int and not is_of(value, int):
            raise ValueError
        return value
    except AirgsError as error:
        raise ValueError(str(error)) from error
    except (ValueError, ArithmeticError) as error:
        raise ValueError(f"expected {_kind_words(kind)}, got {text!r}") from error


def _kind_words(kind: Any) -> str:
    if get_origin(kind) is Literal:
        return "one of " + ", ".join(map(str, get_args(kind)))
    inner = [one for one in get_args(kind) if one is not NoneType] or [kind]
    return KINDS.get(inner[0], ("", "a value"))[1]


def default_words(value: Any) -> str:
    """Returns " (default: …)" for the value of a setting, nothing where there is nothing to say."""
    if value in (None, "", ()) or value is False or value is MISSING:
        return ""
    if value is True:
        return " (default: on)"
    several = value if isinstance(value, tuple) else (value,)
    shown = " ".join(f"{one:g}" if isinstance(one, float) else str(one) for one in several)
    return f" (default: {shown})"


def refusal(error: exceptions.CycloptsError) -> str:
    """Returns what is wrong with arguments, in one line."""
    if isinstance(error, exceptions.CoercionError) and error.token is not None:
        words = error.msg or f"expected {_kind_words(error.target_type)}, got {error.token.value!r}"
        return f"argument {error.token.keyword or _name(error)}: {words}"
    if isinstance(error, exceptions.MissingArgumentError):
        if error.keyword:
            return f"argument {error.keyword}: expected a value, got none"
        return f"expected {_name(error)}, got none"
    if isinstance(error, exceptions.RepeatArgumentError):
        return f"argument {error.token.keyword}: expected one value, got another one: {error.token.value!r}"
    if isinstance(error, exceptions.UnknownOptionError):
        known = [name for argument in error.argument_collection for name in argument.names]
        word = error.token.keyword or error.token.value  # the one where it has a value, else the other
        close = difflib.get_close_matches(word, known, 1)
        return f"argument {word}: expected an option that there is{f' ({close[0]}?)' if close else ''}; see {ALL}"
    if isinstance(error, exceptions.UnknownCommandError):
        known = [name for name in error.app or () if not name.startswith("-")]
        return f"expected one of {', '.join(known)}, got {(error.unused_tokens or ['none'])[0]!r}"
    if isinstance(error, exceptions.UnusedCliTokensError):
        return f"expected no further arguments, got {' '.join(error.unused_tokens or ())}"
    return " ".join(str(error).split())


def _name(error: exceptions.CycloptsError) -> str:
    return error.argument.name if error.argument else "an argument"


@dataclass(frozen=True, slots=True)
class Columns:
    """Prints help in two columns, as wide as the terminal, at most WIDTH; `everything`: not everyday options alone."""

    everything: bool

    def render_usage(self, console: Console, options: Any, usage: Any) -> None:
        self._print(console, textwrap.fill(f"usage: {str(usage).removeprefix('Usage:').strip()}", self._width()))

    def render_description(self, console: Console, options: Any, description: Any) -> None:
        """Print what the command does, paragraph for paragraph as it is written."""
        if text := _text(description):
            self._print(console, "\n".join(["", *(textwrap.fill(line, self._width()) for line in text.split("\n"))]))

    def __call__(self, console: Console, options: Any, panel: HelpPanel) -> None:
        shown = self.everything or panel.title in {one.name for one in (ARGUMENTS, COMMANDS, EVERYDAY)}
        entries = [entry for entry in panel.entries if not FLAGS & set(entry.names)]
        if shown and entries:
            lines = [line for entry in entries for line in self._lines(entry)]
            self._print(console, "\n".join([f"\n{str(panel.title).lower()}:", *lines]))

    def _lines(self, entry: HelpEntry) -> list[str]:
        names = [*entry.positive_shorts, *entry.positive_names, *entry.negative_names]
        head = entry.positional_label or " ".join(filter(None, [", ".join(names), entry.metavar]))
        words = _text(entry.description)
        wrap = textwrap.TextWrapper(self._width(), " " * COLUMN, " " * COLUMN, break_on_hyphens=False)
        lines = wrap.wrap(words if self.everything else DETAIL.sub(r"\1", words)) or [""]
        if len(head) > COLUMN - 4:
            return [f"  {head}", *lines]
        return [f"  {head:<{COLUMN - 2}}{lines[0].strip()}", *lines[1:]]

    def _width(self) -> int:
        return min(WIDTH, shutil.get_terminal_size((WIDTH, 24)).columns)

    def _print(self, console: Console, text: str) -> None:
        console.print(text, markup=False, highlight=False, emoji=False, soft_wrap=True)


def _text(written: Any) -> str:
    """Return what the library makes of a help text, as it was."""
    return "" if written is None else str(getattr(written.primary_renderable, "plain", "")).strip()
