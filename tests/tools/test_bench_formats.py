"""The tables of formats: a line for every format, and only what is between a page's markers is replaced."""

import pytest

from airgs_codec.scene.formats.table import SPLAT
from airgs_codec.scene.formats.write_clips import SPLAT4D
from airgs_codec.scene.ply import write_ply
from airgs_codec.scene.sequence import open_sequence
from tests.support.paths import FOX
from tools.bench_formats import BEGIN, END, clip_row, copies, frame_row, update


def test_copies_are_as_many_as_are_asked_for_and_apart():
    frame = open_sequence(FOX).read(0).take(slice(50))
    rows = copies(frame, 120)
    assert len(rows) == 120 and rows.sh_degree == frame.sh_degree
    assert abs(rows.means[50:100].mean(axis=0) - rows.means[:50].mean(axis=0)).max() > 1


def test_a_format_without_sh_loses_more_than_its_rounding(tmp_path):
    write_ply(tmp_path / "large.ply", copies(open_sequence(FOX).read(0), 6000))
    cells = frame_row(SPLAT, FOX, tmp_path / "large.ply", 1).split(" | ")
    assert cells[:3] == ["| .splat", "none", "kept"]
    assert 30 < float(cells[4].removesuffix(" dB")) < 45
    assert cells[6] == "0.2 MB"


def test_a_clip_has_a_line_as_well():
    cells = clip_row(SPLAT4D, FOX).split(" | ")
    assert cells[:2] == ["| .splat4d", "none"] and float(cells[4].removesuffix(" dB")) > 30


def test_the_rest_of_a_page_stays(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(f"before\n{BEGIN}old\n{END}after\n")
    update(page, "new")
    assert page.read_text() == f"before\n{BEGIN}\nnew\n\n{END}after\n"


def test_a_page_without_markers_is_refused(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("text\n")
    with pytest.raises(ValueError, match="expected the lines"):
        update(page, "new")
    assert page.read_text() == "text\n"
