"""Is the documentation true? Every command parses, every path, name and link exists, and what can be run is run.

    python -m tools.check_docs [--run] [PAGE ...]

Always checked, in every markdown page: each command line in a ```sh block and in `code` goes through the real parser of
its program (a command, a module run by python -m, a target of the Makefile); each path of this repository, each dotted
name of airgs_codec and each option exists; each relative link leads somewhere.

With --run the ```sh and ```python blocks are run as well, in one empty folder a page that has links to tests/ and
tools/; not those marked ```sh not-run, whose data is not in the repository. A ```text block that comes next is what the
block prints: its lines must come in that order, "…" stands for any lines between, and numbers may differ by 5 %
(TOLERANCE), those of another machine or build of x264. Exit status 1 with one line a finding.
"""

from __future__ import annotations

import argparse
import importlib
import os
import re
import shlex
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
from unittest.mock import patch

REPOSITORY = Path(__file__).parent.parent
TOLERANCE = 0.05
FENCE = re.compile(r"^```([^\n]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
INLINE = re.compile(r"`([^`]+)`")
LINK = re.compile(r"\]\(([^)\s]+)\)")
PATH = re.compile(r"(airgs_codec|docs|tests|tools|manifests|\.ci)/[\w./-]*")
NUMBER = re.compile(r"\d[\d,]*(?:\.\d+)?")
OTHER_PROGRAMS = {"git", "cd", "pip", "python3", "source"}


@dataclass(frozen=True, slots=True)
class Block:
    """A fenced block of a page, and the text of the next block if that is a ```text block."""

    info: str
    code: str
    output: str


class _ParserError(Exception):
    """What a parser says of its arguments: nothing, or why it refuses them."""


def pages() -> list[Path]:
    """Every markdown page of the repository."""
    return [
        *sorted(REPOSITORY.glob("*.md")),
        *sorted((REPOSITORY / "docs").glob("*.md")),
        *REPOSITORY.glob("tests/*/*.md"),
        *REPOSITORY.glob("manifests/*/*.md"),
    ]


def blocks(text: str) -> list[Block]:
    """The fenced blocks of a page."""
    found = list(FENCE.finditer(text))
    outputs = [m[2] if m[1] == "text" else "" for m in found[1:]]
    return [Block(m[1], m[2], output) for m, output in zip(found, [*outputs, ""], strict=False)]


def command_lines(code: str) -> list[list[str]]:
    """The commands of a shell block as words, comments and what follows a pipe left out."""
    lines = (shlex.split(line, comments=True) for line in code.replace("\\\n", " ").splitlines())
    return [before_redirection(words) for words in lines if words]


def before_redirection(words: list[str]) -> list[str]:
    """The words of a command before the first `|` or `>`."""
    return list(takewhile(lambda word: word not in ("|", ">"), words))


def findings(page: Path) -> Iterator[str]:
    """What is wrong on a page without running it, one line a finding."""
    text = page.read_text(encoding="utf-8")
    for block in blocks(text):
        if block.info.split()[:1] == ["sh"]:
            yield from (wrong for words in command_lines(block.code) if (wrong := command_error(words, whole=True)))
    prose = FENCE.sub("", text)
    for code in INLINE.findall(prose):
        yield from inline_errors(" ".join(code.split()))
    for target in LINK.findall(prose):
        yield from link_errors(page, target)


def inline_errors(code: str) -> Iterator[str]:
    """What is wrong with a piece of `code`: a command, a path, a dotted name or an option that does not exist."""
    words = code.replace("[", "").replace("]", "").split()
    program = words[0] if words else ""
    if len(words) > 1 and (program in scripts() or words[:2] == ["python", "-m"]):
        yield from filter(None, [command_error(before_redirection(words), whole=False)])
    elif PATH.fullmatch(program) and not (REPOSITORY / program).exists():
        yield f"{program}: no such file"
    elif re.fullmatch(r"airgs(_codec)?(\.\w+)+", code) and not resolves(code.replace("airgs.", "airgs_codec.", 1)):
        yield f"{code}: no such name"
    elif re.fullmatch(r"--[a-z][a-z0-9-]*", program) and program not in known_options():
        yield f"{program}: no command and no tool has this option"


def link_errors(page: Path, target: str) -> Iterator[str]:
    """Whether a relative link leads to a file, and its anchor to a heading there."""
    if "://" in target:
        return
    path, _, anchor = target.partition("#")
    file = page.parent / path if path else page
    if not file.exists():
        yield f"{target}: no such file"
    elif anchor and anchor not in headings(file.read_text(encoding="utf-8")):
        yield f"{target}: no such heading"


def headings(text: str) -> set[str]:
    """Anchors of the headings of a page, as GitHub makes them."""
    titles = re.findall(r"^#+ (.*)$", FENCE.sub("", text), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def scripts() -> dict[str, str]:
    """The installed commands: name to module:function."""
    return dict(tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]["scripts"])


def known_options() -> set[str]:
    """Every option that a command or a tool of this repository declares."""
    folders = ("airgs_codec/cli", "tools", "tests/long", "tests/makers")
    sources = [path for folder in folders for path in (REPOSITORY / folder).glob("*.py")]
    return {option for path in sources for option in re.findall(r'"(--[a-z][a-z0-9-]*)"', path.read_text())}


def resolves(name: str) -> bool:
    """Whether a dotted name is a module, or something in one."""
    parts = name.split(".")
    for split in range(len(parts), 0, -1):
        try:
            value: object = importlib.import_module(".".join(parts[:split]))
        except ModuleNotFoundError:
            continue
        for part in parts[split:]:
            if not hasattr(value, part):
                return False
            value = getattr(value, part)
        return True
    return False


def command_error(words: list[str], whole: bool) -> str | None:
    """What the program says against its arguments; where not `whole`, required ones may be missing."""
    program, *arguments = words
    if program in OTHER_PROGRAMS:
        return None
    if program == "make":
        targets = re.findall(r"^([\w-]+):", (REPOSITORY / "Makefile").read_text(), re.MULTILINE)
        return next((f"make {word}: no such target" for word in arguments if word not in targets), None)
    if program == "python" and arguments[:1] == ["-m"]:
        entry, arguments = f"{arguments[1]}:main", arguments[2:]
        if not arguments and not whole:
            return None if resolves(words[2]) else f"{words[2]}: no such module"
    elif program in scripts():
        entry = scripts()[program]
    else:
        return f"{program}: neither a command of this repository nor one of {', '.join(sorted(OTHER_PROGRAMS))}"
    refusal = _refusal(entry, arguments)
    if refusal is None or (refusal.startswith("the following arguments are required") and not whole):
        return None
    return f"{shlex.join(words)}: {refusal}"


def _refusal(entry: str, arguments: list[str]) -> str | None:
    """Run a program as far as its parser. None: the arguments are good."""
    module, _, function = entry.partition(":")
    parse = argparse.ArgumentParser.parse_args

    def stop(self: argparse.ArgumentParser, *args: object) -> None:
        parse(self, *args)  # type: ignore[call-overload]
        raise _ParserError

    def refuse(_: argparse.ArgumentParser, message: str) -> None:
        raise _ParserError(message)

    try:
        main = getattr(importlib.import_module(module), function, lambda: None)  # a module may just print
    except ModuleNotFoundError as error:
        return str(error)
    with (
        patch.object(argparse.ArgumentParser, "parse_args", stop),
        patch.object(argparse.ArgumentParser, "error", refuse),
        patch.object(sys, "argv", [module, *arguments]),
    ):
        try:
            main()
        except _ParserError as error:
            return str(error) or None
    return "takes no arguments" if arguments else None


def run_page(page: Path, folder: Path) -> Iterator[str]:
    """Run the ```sh and ```python blocks of a page in `folder`, an empty one; a line for each that fails."""
    for name in ("tests", "tools"):
        (folder / name).symlink_to(REPOSITORY / name)
    found = (run_block(block, folder) for block in blocks(page.read_text(encoding="utf-8")))
    yield from (wrong for wrong in found if wrong)


def run_block(block: Block, folder: Path) -> str | None:
    """Run a ```sh or ```python block in `folder`; None for others, and when it prints what the page says."""
    shell = ["bash", "-e", "-o", "pipefail", "-c"]
    runner = {"sh": shell, "python": [sys.executable, "-c"]}.get(block.info)
    if runner is None:
        return None
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = os.environ | {"PATH": path, "PYTHONPATH": str(REPOSITORY)}
    done = subprocess.run(
        [*runner, block.code], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    if done.returncode:
        return f"{block.code.strip()}: exit status {done.returncode}: {done.stderr.strip()[-500:]}"
    missing = first_difference(block.output, done.stdout)
    return None if missing is None else f"{block.code.strip()}: does not print {missing!r}"


def first_difference(expected: str, printed: str) -> str | None:
    """The first expected line that does not come in its place, None if all do."""
    rest = [line for line in printed.splitlines() if line.strip()]
    anywhere = False
    for line in (line for line in expected.splitlines() if line.strip()):
        if line.strip() == "…":
            anywhere = True
            continue
        window = range(len(rest) if anywhere else min(1, len(rest)))
        place = next((i for i in window if same_line(line, rest[i])), None)
        if place is None:
            return line
        rest, anywhere = rest[place + 1 :], False
    return None


def same_line(a: str, b: str) -> bool:
    """Equal words, and numbers that differ by TOLERANCE at most."""
    if NUMBER.sub("#", a).split() != NUMBER.sub("#", b).split():
        return False
    pairs = zip(NUMBER.findall(a), NUMBER.findall(b), strict=True)
    numbers = ((float(x.replace(",", "")), float(y.replace(",", ""))) for x, y in pairs)
    return all(abs(x - y) <= TOLERANCE * max(abs(x), abs(y)) for x, y in numbers)


def main() -> int:
    """Check the pages named, or all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pages", type=Path, nargs="*", metavar="PAGE", help="default: every page of the repository")
    parser.add_argument("--run", action="store_true", help="run the shell blocks, too (several minutes)")
    args = parser.parse_args()
    wrong = 0
    for page in args.pages or pages():
        found = list(findings(page))
        if args.run:
            with tempfile.TemporaryDirectory() as folder:
                found += run_page(page, Path(folder))
        wrong += len(found)
        for line in found:
            print(f"{page}: {line}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
