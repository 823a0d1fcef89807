"""How help is printed: usage, what the command does, and groups of options in two columns."""

from __future__ import annotations

import re
import shutil
import textwrap
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cyclopts import Group

if TYPE_CHECKING:
    from cyclopts.help import HelpEntry, HelpPanel
    from rich.console import Console

EVERYDAY = Group("Options", sort_key=1)
ARGUMENTS = Group("Arguments", sort_key=0)
COMMANDS = Group("Commands", sort_key=0)
FLAGS = {"--help", "--version"}
DETAIL = re.compile(r"; .*?( \(default: [^()]*\))?$")  # of a help text: what follows the first semicolon
WIDTH, COLUMN = 100, 30  # of help: characters in a line at most, and before what options mean


@dataclass(frozen=True, slots=True)
class Columns:
    """Prints help in two columns, as wide as the terminal, at most WIDTH; `everything`: not everyday options alone."""

    everything: bool

    def render_usage(self, console: Console, options: Any, usage: Any) -> None:
        """Print how the command is called."""
        self._print(console, textwrap.fill(f"usage: {str(usage).removeprefix('Usage:').strip()}", self._width()))

    def render_description(self, console: Console, options: Any, description: Any) -> None:
        """Print what the command does, paragraph for paragraph as it is written."""
        if text := _text(description):
            self._print(console, "\n".join(["", *(textwrap.fill(line, self._width()) for line in text.split("\n"))]))

    def __call__(self, console: Console, options: Any, panel: HelpPanel) -> None:
        """Print a group of options."""
        shown = self.everything or panel.title in {one.name for one in (ARGUMENTS, COMMANDS, EVERYDAY)}
        entries = [entry for entry in panel.entries if not FLAGS & set(entry.names)]
        if shown and entries:
            lines = [line for entry in entries for line in self._lines(entry)]
            self._print(console, "\n".join([f"\n{str(panel.title).lower()}:", *lines]))

    def _lines(self, entry: HelpEntry) -> list[str]:
        names = [*entry.positive_shorts, *entry.positive_names, *entry.negative_names]
        head = entry.positional_label or ", ".join(names)
        if entry.metavar and not entry.positional_label:
            head += f" {entry.metavar}"
        words = _text(entry.description)
        return self._columns(head, words if self.everything else DETAIL.sub(r"\1", words))

    def _columns(self, head: str, words: str) -> list[str]:
        indent = " " * COLUMN
        wrap = textwrap.TextWrapper(self._width(), indent, indent, break_on_hyphens=False)
        lines = wrap.wrap(words) or [""]
        if len(head) > COLUMN - 4:
            return [f"  {head}", *lines]
        return [f"  {head:<{COLUMN - 2}}{lines[0].strip()}", *lines[1:]]

    def _width(self) -> int:
        return min(WIDTH, shutil.get_terminal_size((WIDTH, 24)).columns)

    def _print(self, console: Console, text: str) -> None:
        console.print(text, markup=False, highlight=False, emoji=False, soft_wrap=True)


def _text(written: Any) -> str:
    """What the library makes of a help text, as it was."""
    return "" if written is None else str(getattr(written.primary_renderable, "plain", "")).strip()
