"""Progress where nobody looks at a terminal, and words that it cannot show."""

import io
import sys

import pytest

from airgs_codec.cli import terminal


@pytest.mark.parametrize("encoding", ["ascii", "cp1252"])
def test_what_an_encoding_lacks_is_escaped(encoding, monkeypatch):
    out = io.TextIOWrapper(io.BytesIO(), encoding=encoding)
    monkeypatch.setattr(sys, "stdout", out)
    assert terminal.run_command("name", lambda: terminal.say("\u2192 \u0394E") or 0) == 0
    assert out.buffer.getvalue() == b"\\u2192 \\u0394E\n"


def test_a_log_gets_a_line_of_progress_every_ten_seconds(monkeypatch, capsys):
    now = [0.0]
    monkeypatch.setattr(terminal.time, "monotonic", lambda: now[0])
    bar = terminal.Bar()
    for second in range(0, 36, 3):
        now[0] = float(second)
        bar("frames", second, 100)
    bar.close()
    assert capsys.readouterr().err.splitlines() == [
        "frames: 12 of 100, after 12 s, about 88 s left",
        "frames: 24 of 100, after 24 s, about 76 s left",
    ]


def test_quiet_work_says_nothing(monkeypatch, capsys):
    now = [0.0]
    monkeypatch.setattr(terminal.time, "monotonic", lambda: now[0])
    bar = terminal.Bar(quiet=True)
    now[0] = 100.0
    bar("frames", 1, 2)
    assert capsys.readouterr().err == ""
