"""The tables of formats: a row for every format."""

import pytest

from airgs_codec.scene.formats.ply import write_ply
from airgs_codec.scene.formats.table import SPLAT
from airgs_codec.scene.sequence import open_sequence
from tests.support.paths import FOX
from tools.lab.bench.formats import copies, frame_row


def test_copies_are_as_many_as_are_asked_for_and_apart():
    frame = open_sequence(FOX).read(0).take(slice(50))
    rows = copies(frame, 120)
    assert len(rows) == 120 and rows.sh_degree == frame.sh_degree
    assert abs(rows.means[50:100].mean(axis=0) - rows.means[:50].mean(axis=0)).max() > 1


def test_a_format_without_sh_loses_more_than_its_rounding(tmp_path):
    write_ply(tmp_path / "large.ply", copies(open_sequence(FOX).read(0), 6000))
    row = frame_row(SPLAT, FOX, tmp_path / "large.ply", 1)
    assert (row["format"], row["SH"], row["order of rows"]) == (".splat", "none", "kept")
    assert 30 < row["PSNR, dB"] < 45 and row["large, MB"] == pytest.approx(0.2, abs=0.05)
    assert row["read, s"] > 0 and row["memory, MB"] > 10
