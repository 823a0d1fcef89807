"""The documentation says nothing that is not there; `python -m tools.check_docs --run` runs its commands, too."""

import re

import pytest

from tests.support.paths import REPOSITORY
from tools import check_docs

README_WORDS = 900


@pytest.mark.parametrize("page", check_docs.pages(), ids=lambda page: page.name)
def test_commands_parse_and_paths_names_and_links_exist(page):
    assert list(check_docs.findings(page)) == []


def test_the_python_examples_of_the_readme_run(tmp_path):
    (tmp_path / "tests").symlink_to(REPOSITORY / "tests")
    examples = [b for b in check_docs.blocks((REPOSITORY / "README.md").read_text()) if b.info == "python"]
    assert examples
    assert [check_docs.run_block(block, tmp_path) for block in examples] == [None] * len(examples)


def test_the_readme_is_short():
    assert len((REPOSITORY / "README.md").read_text().split()) <= README_WORDS


@pytest.mark.parametrize(
    ("code", "finding"),
    [
        ("airgs-encode scene/ --no-such-option", "unrecognized arguments"),
        ("airgs-play scene.airgs --decode 4 --policy", "expected one argument"),
        ("python -m tools.no_such_tool --quick", "No module"),
        ("python -m tools.bench_encode fox/ --lots 3", "unrecognized arguments"),
        ("tools/no_such_tool.py", "no such file"),
        ("airgs_codec.coding.motion.no_such_name", "no such name"),
        ("airgs.no_such_name", "no such name"),
        ("--no-such-option 3", "no command"),
    ],
)
def test_what_is_not_there_is_found(code, finding):
    assert any(finding in line for line in check_docs.inline_errors(code))


def test_a_required_argument_is_missed_in_a_block_but_not_in_prose():
    assert check_docs.command_error(["airgs-decode", "scene.airgs"], whole=True)
    assert check_docs.command_error(["airgs-decode", "scene.airgs"], whole=False) is None


def test_links_lead_to_files_and_headings(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("# One\n## Two words, here\n")
    wrong = [check_docs.link_errors(page, target) for target in ("#two-words-here", "page.md#one", "#three", "no.md")]
    assert [len(list(lines)) for lines in wrong] == [0, 0, 1, 1]


@pytest.mark.parametrize(
    ("expected", "printed", "difference"),
    [
        ("a 10.0\nb 3", "a 10.2\nb 3", None),
        ("a 10.0\nb 3", "a 12.0\nb 3", "a 10.0"),
        ("a 1\n…\nb 3", "a 1\nx\ny\nb 3\nz", None),
        ("a 1\nb 3", "a 1\nx\nb 3", "b 3"),
        ("b 3", "", "b 3"),
    ],
)
def test_pasted_output_is_compared_line_by_line(expected, printed, difference):
    assert check_docs.first_difference(expected, printed) == difference


def test_every_page_is_looked_at():
    names = {page.relative_to(REPOSITORY).as_posix() for page in check_docs.pages()}
    assert {"README.md", "FORMAT.md", "docs/numerics.md", "tests/data/README.md"} <= names
    assert all(re.search(r"\w", page.read_text()) for page in check_docs.pages())


def test_blocks_are_told_apart_and_keep_their_output():
    text = "```sh\nairgs-play a\n```\n\n```text\nplayed 1\n```\n\nwords\n\n```sh not-run\nmake demo\n```\n"
    found = [(b.info, b.code, b.output) for b in check_docs.blocks(text)]
    assert found == [
        ("sh", "airgs-play a\n", "played 1\n"),
        ("text", "played 1\n", ""),
        ("sh not-run", "make demo\n", ""),
    ]


def test_every_file_of_the_documentation_is_linked_from_a_page():
    linked = {
        (page.parent / target).resolve()
        for page in check_docs.pages()
        for target in check_docs.LINK.findall(page.read_text())
    }
    assert [path.name for path in (REPOSITORY / "docs").iterdir() if path.resolve() not in linked] == []
