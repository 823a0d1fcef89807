"""A device that cannot be had is one line and 2, and nothing is written."""

import pytest

from airgs_codec.cli import encode, play, train
from airgs_codec.render import backend
from tests.support.paths import FOX, FOX_VIEWS, VALID


@pytest.mark.parametrize(
    ("command", "arguments"),
    [
        (train, [FOX_VIEWS, "-o"]),
        (encode, [FOX, "--calibrate", "none", "-o"]),
        (encode, [FOX_VIEWS, "-o"]),
        (play, [VALID / "two-groups-sh1", "--trace", FOX / "trace.csv", "--video"]),
    ],
)
def test_cuda_where_there_is_none_is_refused(command, arguments, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(backend, "_missing", lambda: "torch sees no CUDA device")
    before = sorted(FOX_VIEWS.parent.iterdir())
    target = tmp_path / ("out.mp4" if command is play else "out")
    assert command.main([*map(str, arguments), str(target), "--device", "cuda"]) == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert said[-1].endswith("--device cuda: torch sees no CUDA device") and len(said) == 1
    assert list(tmp_path.iterdir()) == [] and sorted(FOX_VIEWS.parent.iterdir()) == before
