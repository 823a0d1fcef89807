"""Is the documentation true? Every command parses, every path, name and link exists, and what can be run is run.

    python -m tools.check_docs [--run] [PAGE ...]

Always checked, in every markdown page: each command line in a ```sh block and in `code` goes through the real parser of
its program (a command, a module run by python -m, a target of the Makefile); each path of this repository, each dotted
name of airgs_codec and each option exists; each relative link leads somewhere.

With --run, as in tests/test_docs.py, the ```sh and ```python blocks of the user pages are run as well, in page order
and in one folder with links to manifests/, tests/ and tools/. A command that stands on several pages is run once.
Blocks marked ```sh not-run need data that is not in the repository. A ```text block that comes next is what the block
prints: its lines must come in that order, and "…" stands for any lines between. Whole numbers must be equal; others
may differ by SHARE, which is 0.3 dB at 44 dB, or by one unit of the last digit shown. Exit status 1 with one line a
finding.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import importlib.util
import io
import re
import shlex
import sys
import tempfile
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from unittest.mock import patch

from cyclopts import App, CycloptsError, MissingArgumentError

from airgs_codec.cli import options
from airgs_codec.cli.manifest import app as manifest_app
from tools.lab.experiments import EXPERIMENTS

REPOSITORY = Path(__file__).parent.parent
SHARE = 0.007
FENCE = re.compile(r"^```([^\n]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
INLINE = re.compile(r"`([^`]+)`")
LINK = re.compile(r"\]\(([^)\s]+)\)")
PATH = re.compile(r"(airgs_codec|docs|tests|tools|manifests|\.ci)/[\w./-]*")
MISSING = "the following arguments are required"
NUMBER = re.compile(r"\d[\d,]*(?:\.\d+)?")
OTHER_PROGRAMS = {"git", "cd", "docker", "pip", "python3", "source"}


@dataclass(frozen=True, slots=True)
class Block:
    """A fenced block of a page, and the text of the next block if that is a ```text block."""

    info: str
    code: str
    output: str


class _ParserError(Exception):
    """What a parser says of its arguments: nothing, or why it refuses them."""


def user_pages() -> list[Path]:
    """The pages for users, the README first; their blocks are run."""
    return [REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").glob("*.md"))]


def pages() -> list[Path]:
    others = [page for page in sorted(REPOSITORY.glob("*.md")) if page.name != "README.md"]
    deeper = [REPOSITORY.glob(pattern) for pattern in ("docs/*/*.md", "tests/*/*.md", "manifests/*/*.md", "web/*.md")]
    return [*user_pages(), *others, *(page for found in deeper for page in sorted(found))]


def blocks(text: str) -> list[Block]:
    found = list(FENCE.finditer(text))
    outputs = [m[2] if m[1] == "text" else "" for m in found[1:]]
    return [Block(m[1], m[2], output) for m, output in zip(found, [*outputs, ""], strict=False)]


def commands(code: str) -> Iterator[list[str]]:
    """The commands of a shell block as words, those joined by `|` one after the other, without comments."""
    for line in code.replace("\\\n", " ").splitlines():
        words = shlex.split(line, comments=True)
        while "|" in words:
            cut = words.index("|")
            yield words[:cut]
            words = words[cut + 1 :]
        if words:
            yield words


def findings(page: Path) -> Iterator[str]:
    text = page.read_text(encoding="utf-8")
    for block in blocks(text):
        if block.info.split()[:1] == ["sh"]:
            yield from filter(None, (command_error(words, whole=True) for words in commands(block.code)))
    prose = FENCE.sub("", text)
    for code in INLINE.findall(prose):
        yield from inline_errors(" ".join(code.split()))
    for target in LINK.findall(prose):
        yield from link_errors(page, target)


def inline_errors(code: str) -> Iterator[str]:
    """Yield what is wrong with a piece of `code`: a command, a path, a dotted name or an option that does not exist."""
    words = code.replace("[", "").replace("]", "").split()
    program = words[0] if words else ""
    if len(words) > 1 and (program in scripts() or words[:2] == ["python", "-m"]):
        yield from filter(None, (command_error(command, whole=False) for command in commands(shlex.join(words))))
    elif PATH.fullmatch(program) and not (REPOSITORY / program).exists():
        yield f"{program}: no such file"
    elif re.fullmatch(r"airgs(_codec)?(\.\w+)+", code) and not resolves(code.replace("airgs.", "airgs_codec.", 1)):
        yield f"{code}: no such name"
    elif re.fullmatch(r"--[a-z][a-z0-9.-]*", program) and program not in known_options():
        yield f"{program}: no command and no tool has this option"


def link_errors(page: Path, target: str) -> Iterator[str]:
    """Yield whether a relative link leads to a file, and its anchor to a heading there."""
    if "://" in target:
        return
    path, _, anchor = target.partition("#")
    file = page.parent / path if path else page
    if not file.exists():
        yield f"{target}: no such file"
    elif anchor and anchor not in headings(file.read_text(encoding="utf-8")):
        yield f"{target}: no such heading"


def headings(text: str) -> set[str]:
    titles = re.findall(r"^#+ (.*)$", FENCE.sub("", text), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def scripts() -> dict[str, str]:
    return dict(tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]["scripts"])


@cache
def known_options() -> set[str]:
    """Every option that a command, a tool or an experiment of this repository declares."""
    sources = [
        path for folder in ("tools", "tests/long", "tests/makers") for path in (REPOSITORY / folder).rglob("*.py")
    ]
    declared = {option for path in sources for option in re.findall(r'"(--[a-z][a-z0-9-]*)"', path.read_text())}
    programs = [[name] for name in scripts()] + [["airgs-manifest", name] for name in manifest_app]
    programs += [["python", "-m", "tools.lab", one.name] for one in EXPERIMENTS]
    helps = io.StringIO()
    with contextlib.redirect_stdout(helps):
        for words in programs:
            main, argv = _main_of([*words, "--help-all"])
            with patch.object(sys, "argv", argv):
                main()
    return declared | set(re.findall(r"--[a-z][a-z0-9.-]*", helps.getvalue()))


def resolves(name: str) -> bool:
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
    """Return what the program says against its arguments; where not `whole`, required ones may be missing."""
    program, *arguments = words
    if program in OTHER_PROGRAMS:
        return None
    if program == "make":
        targets = re.findall(r"^([\w-]+):", (REPOSITORY / "Makefile").read_text(), re.MULTILINE)
        return next(
            (f"make {word}: no such target" for word in arguments if word not in targets and "=" not in word), None
        )
    module = program == "python" and arguments[:1] == ["-m"]
    if not module and program not in scripts():
        return f"{program}: neither a command of this repository nor one of {', '.join(sorted(OTHER_PROGRAMS))}"
    if module and len(words) == 3 and (not whole or words[2].startswith("tests.makers.")):  # makers take no arguments
        return None if resolves(words[2]) else f"{words[2]}: no such module"
    refusal = _refusal(words)
    if refusal is None or (MISSING in refusal and not whole):
        return None
    return f"{shlex.join(words)}: {refusal}"


def _main_of(words: list[str]) -> tuple[Callable[[], int | None], list[str]]:
    """The function behind a command and its `sys.argv`. Raises ModuleNotFoundError."""
    if words[0] == "python":
        name, arguments = words[2], words[3:]
        found = importlib.util.find_spec(name)
        package = found is not None and found.submodule_search_locations is not None
        entry = f"{name}.__main__:main" if package else f"{name}:main"
    else:
        entry, arguments = scripts()[words[0]], words[1:]
    module, _, function = entry.partition(":")
    return getattr(importlib.import_module(module), function, lambda: None), [words[0], *arguments]


def _refusal(words: list[str]) -> str | None:
    parse = argparse.ArgumentParser.parse_args

    def stop(self: argparse.ArgumentParser, *args: object) -> None:
        parse(self, *args)  # type: ignore[call-overload]
        raise _ParserError

    def stop_app(app: App, words: list[str]) -> None:
        try:
            if "--help-all" not in words:
                app.parse_args(words)
        except CycloptsError as error:
            missing = isinstance(error, MissingArgumentError) and not error.keyword
            raise _ParserError(MISSING if missing else str(error)) from error
        raise _ParserError

    def refuse(_: argparse.ArgumentParser, message: str) -> None:
        raise _ParserError(message)

    try:
        main, argv = _main_of(words)
    except ModuleNotFoundError as error:
        return str(error)
    with (
        patch.object(argparse.ArgumentParser, "parse_args", stop),
        patch.object(argparse.ArgumentParser, "error", refuse),
        patch.object(options, "_run", stop_app),
        patch.object(sys, "argv", argv),
        contextlib.redirect_stdout(io.StringIO()),
    ):
        try:
            main()
        except _ParserError as error:
            return str(error) or None
        except SystemExit:  # --help
            return None
    return "takes no arguments" if len(argv) > 1 else None


@dataclass(frozen=True, slots=True)
class Workshop:
    """A folder in which blocks are run, and what each command has printed there: none is run twice."""

    folder: Path
    printed: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("manifests", "tests", "tools"):
            (self.folder / name).symlink_to(REPOSITORY / name)

    def run_page(self, page: Path) -> Iterator[str]:
        """Run the ```sh and ```python blocks of a page; a line for each that fails or prints something else."""
        yield from filter(None, map(self.run_block, blocks(page.read_text(encoding="utf-8"))))

    def run_block(self, block: Block) -> str | None:
        """Run a ```sh or ```python block; None for others, and when it prints what the page says."""
        if block.info not in ("sh", "python"):
            return None
        try:
            if block.info == "sh":
                printed = "".join(self.run_command(words) for words in commands(block.code))
            else:
                printed = self._capture(lambda: exec(block.code, {"__name__": "__main__"}))
        except (Exception, SystemExit) as error:  # whatever an example ends with is a finding
            return f"{block.code.strip()}: {type(error).__name__}: {error}"
        missing = first_difference(block.output, printed)
        return None if missing is None else f"{block.code.strip()}: does not print {missing!r}"

    def run_command(self, words: list[str]) -> str:
        """Return what a command prints. Raises SystemExit where it fails."""
        line = shlex.join(words)
        if line not in self.printed:
            main, argv = _main_of(words)
            with patch.object(sys, "argv", argv):
                self.printed[line] = self._capture(lambda: sys.exit(main()))
        return self.printed[line]

    def _capture(self, run: Callable[[], object]) -> str:
        out = io.StringIO()
        with contextlib.chdir(self.folder), contextlib.redirect_stdout(out):
            try:
                run()
            except SystemExit as end:
                if end.code:
                    raise
        return out.getvalue()


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
    if NUMBER.sub("#", a).split() != NUMBER.sub("#", b).split():
        return False
    return all(same_number(x, y) for x, y in zip(NUMBER.findall(a), NUMBER.findall(b), strict=True))


def same_number(a: str, b: str) -> bool:
    """Equal whole numbers; others within SHARE, or within one unit of the last digit of `a`."""
    if "." not in a:
        return a == b
    x, y = (float(number.replace(",", "")) for number in (a, b))
    unit = 10.0 ** -len(a.partition(".")[2])
    return abs(x - y) <= max(SHARE * abs(x), 1.001 * unit)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pages", type=Path, nargs="*", metavar="PAGE", help="default: every page of the repository")
    parser.add_argument("--run", action="store_true", help="run the blocks of user pages, too (minutes)")
    args = parser.parse_args()
    wrong = [f"{page}: {line}" for page in args.pages or pages() for line in findings(page)]
    if args.run:
        with tempfile.TemporaryDirectory() as folder:
            shop = Workshop(Path(folder))
            runnable = [page.resolve() for page in args.pages] or user_pages()
            wrong += [f"{page}: {line}" for page in runnable for line in shop.run_page(page)]
    print("\n".join(wrong), end="\n" if wrong else "")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
