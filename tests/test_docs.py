"""The documentation says nothing that is not there; blocks of user pages run, and print what the pages say."""

import re

import pytest

from tests.faces import EncodeSettings, encode, open_sequence
from tests.support.paths import FOX, FOX_VIEWS, REPOSITORY
from tests.support.scenes import write_demo
from tools import check_docs

MOST_WORDS = {"README.md": 800, "CONTRIBUTING.md": 710, "FORMAT.md": 4600}
USER_PAGES = [
    "README", "browser", "encoding", "farm", "formats", "playing", "python", "security", "serving", "tools",
    "tracking", "training",
]  # fmt: skip


@pytest.fixture(scope="module")
def shops(tmp_path_factory):
    """Where blocks run: those whose output stands on a page with the scene as it is, others with few rows of it."""
    whole, few = (check_docs.Workshop(tmp_path_factory.mktemp(name)) for name in ("whole", "few"))
    data = few.folder / "tests" / "data"
    data.parent.unlink()
    write_demo(data / "fox", frames=10, rows=300, scale=0.2)
    (data / "fox" / "trace.csv").symlink_to(FOX / "trace.csv")
    (data / "fox_views").symlink_to(FOX_VIEWS)
    settings = EncodeSettings(calibrate="none", measure_pictures=2, preset="ultrafast")
    encode(open_sequence(data / "fox"), few.folder / "fox.airgs", settings)
    (few.folder / "talk.airgs").symlink_to(few.folder / "fox.airgs")
    return {True: whole, False: few}


@pytest.mark.parametrize("page", check_docs.user_pages(), ids=lambda page: page.name)
def test_commands_and_python_of_user_pages_run(page, shops):
    blocks = check_docs.blocks(page.read_text())
    assert [wrong for block in blocks if (wrong := shops[block.output != ""].run_block(block))] == []


def test_commands_parse_and_paths_names_and_links_exist():
    assert [(page, finding) for page in check_docs.pages() for finding in check_docs.findings(page)] == []
    lines = re.findall(r"^\t-?\$\(BIN\)/(airgs-.*|python -m .*)", (REPOSITORY / "Makefile").read_text(), re.MULTILINE)
    assert len(lines) > 9 and [error for line in lines if (error := check_docs.command_error(line.split(), True))] == []


def test_pages_are_short():
    seen = {page: re.sub(r"<!--.*?-->", "", page.read_text(), flags=re.DOTALL) for page in check_docs.pages()}
    words, user = ({page: len(text.split()) for page, text in seen.items()}, check_docs.user_pages())
    assert [name for name, most in MOST_WORDS.items() if words[REPOSITORY / name] > most] == []
    assert [page.stem for page in user] == USER_PAGES
    assert [page.name for page in user if words[page] > 1000] == []
    assert sum(words[page] for page in user) <= 7600 and sum(words.values()) <= 19_500


@pytest.mark.parametrize(("code", "finding"), [
    ("airgs-encode scene/ --no-such-option", "Unknown option"),
    ("airgs-play scene.airgs --seed 4 --policy", "requires an argument"),
    ("airgs-train views/ | airgs-encode model/ --no-such-option", "Unknown option"),
    ("python -m tools.no_such_tool --quick", "No module"),
    ("python -m tools.check_docs --lots 3", "unrecognized arguments"),
    ("tools/no_such_tool.py", "no such file"),
    ("airgs_codec.coding.motion.no_such_name", "no such name"),
    ("airgs.no_such_name", "no such name"),
    ("--no-such-option 3", "no command"),
])  # fmt: skip
def test_what_is_not_there_is_found(code, finding):
    assert any(finding in line for line in check_docs.inline_errors(code))


def test_links_lead_to_files_and_headings_and_a_required_argument_is_missed_in_a_block_but_not_in_prose(tmp_path):
    (tmp_path / "page.md").write_text("# One\n## Two words, here\n")
    for target, wrong in (("#two-words-here", 0), ("page.md#one", 0), ("#three", 1), ("no.md", 1)):
        assert len(list(check_docs.link_errors(tmp_path / "page.md", target))) == wrong, target
    for whole in (True, False):
        assert bool(check_docs.command_error(["airgs-decode", "scene.airgs"], whole)) == whole


@pytest.mark.parametrize(("expected", "printed", "difference"), [
    ("a 44.5 dB\nb 3", "a 44.8 dB\nb 3", None),
    ("a 44.5 dB\nb 3", "a 44.9 dB\nb 3", "a 44.5 dB"),
    ("a 0.4", "a 0.5", None),
    ("a 0.4", "a 0.6", "a 0.4"),
    ("a 1\n…\nb 3", "a 1\nx\ny\nb 3\nz", None),
    ("a 1\nb 3", "a 1\nx\nb 3", "b 3"),
    ("b 1,000", "b 1,001", "b 1,000"),
    ("b 3", "", "b 3"),
])  # fmt: skip
def test_pasted_output_is_compared_line_by_line(expected, printed, difference):
    assert check_docs.first_difference(expected, printed) == difference


@pytest.mark.parametrize(("info", "code", "finding"), [
    ("sh", "python -m tools.check_docs tests/data/README.md", None),
    ("sh", "airgs-manifest validate nothing.airgs", "SystemExit"),
    ("python", "print('seen')", None),
    ("python", "print('unseen')", "does not print 'seen'"),
    ("python", "1 / 0", "ZeroDivisionError"),
    ("sh not-run", "airgs-encode nothing/", None),
])  # fmt: skip
def test_what_fails_or_prints_something_else_is_found(info, code, finding, tmp_path):
    wrong = check_docs.Workshop(tmp_path).run_block(check_docs.Block(info, code, "seen\n" if info == "python" else ""))
    assert (wrong is None) if finding is None else finding in wrong


def test_blocks_are_told_apart_every_page_is_looked_at_and_every_file_is_linked_from_one():
    text = "```sh\nairgs-play a\n```\n\n```text\nplayed 1\n```\n\nwords\n\n```sh not-run\nmake demo\n```\n"
    found = [(block.info, block.code, block.output) for block in check_docs.blocks(text)]
    shell = ("sh", "airgs-play a\n", "played 1\n")
    assert found == [shell, ("text", "played 1\n", ""), ("sh not-run", "make demo\n", "")]
    pages = {page.relative_to(REPOSITORY).as_posix(): page for page in check_docs.pages()}
    assert {"README.md", "FORMAT.md", "docs/results/numerics.md", "tests/data/README.md"} <= pages.keys()
    texts = {page: page.read_text() for page in pages.values()}
    assert all(re.search(r"\w", text) for text in texts.values())
    targets = [(page, target) for page, text in texts.items() for target in check_docs.LINK.findall(text)]
    linked = {(page.parent / target.partition("#")[0]).resolve() for page, target in targets}
    files = [path for path in (REPOSITORY / "docs").rglob("*") if path.is_file()]
    assert [path.name for path in files if path.resolve() not in linked] == []
