"""What sharing an encode gains: every way is timed, and the answer says which is quickest."""

import pytest

from tools.lab.bench.jobs import DEFAULT, ONE, TWO, Options, run, words
from tools.lab.command import Lab


def test_every_way_is_timed(tmp_path):
    (table,) = run(Options(frames=4, rows=100), Lab.at(tmp_path)).tables()
    assert [row["way"] for row in table.rows] == [ONE, DEFAULT, TWO] and all(row["seconds"] > 0 for row in table.rows)


@pytest.mark.parametrize(
    ("seconds", "said"),
    [
        ((30.0, 20.0, 16.0), "at best 1.9 times as fast as one process with one thread."),
        ((10.0, 20.0, 16.0), ": sharing gains nothing."),
    ],
)
def test_sharing_gains_or_does_not(seconds, said):
    text = words(dict(zip((ONE, DEFAULT, TWO), seconds, strict=True)), Options())
    assert text.startswith(f"120 frames of 20,000 Gaussians in groups of 10 take {seconds[0]:.1f} s in one process")
    assert f"{said} The packages are the same to the byte." in text
