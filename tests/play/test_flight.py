"""Films along a camera path: their pictures, their length, and that they are whole or not there."""

import json
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from airgs_codec.cli.play import main
from airgs_codec.decoder.decode import decode
from airgs_codec.errors import CodecError, SceneError
from airgs_codec.media.image import to_bytes
from airgs_codec.media.movie import VideoReader
from airgs_codec.package.package import open_package
from airgs_codec.package.region import place_view
from airgs_codec.play.report.flight import film_along, open_path
from airgs_codec.render.backend import CPU
from airgs_codec.render.cpu import render
from airgs_codec.scene.camera import with_pixels
from tests.support.paths import GOLDEN


@pytest.fixture(scope="module")
def fox():
    return open_package(GOLDEN / "fox")


@pytest.fixture
def path(tmp_path, fox):
    """A second from the first place of the region, and to another."""
    first, other = fox.manifest.region.places[0], fox.manifest.region.places[-1]
    file = tmp_path / "path.json"
    frames = [
        {"t": t, "position": p.position, "focus": p.focus, "up": p.up} for t, p in enumerate([first, other, first])
    ]
    file.write_text(json.dumps({"keyframes": frames}))
    return file


def film(options, package=GOLDEN / "fox"):
    return main([str(package), *map(str, options)])


def test_a_film_begins_at_the_first_keyframe_and_ends_at_the_last(tmp_path, fox, path, capsys):
    out = tmp_path / "film.mp4"
    assert film(["--path", path, "--video", out, "--size", "96x64", "--fps", "8", "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)
    seen = VideoReader(out)
    assert (seen.size, seen.fps, seen.frames) == ((96, 64), 8, 17)
    assert figures["pictures"] == 17 and figures["pictures_per_s"] > 0
    m = fox.manifest
    view = place_view(m.region, m.region.places[0])
    focal = 32 / np.tan(np.radians(m.region.fov_y / 2))
    for number in (0, 16):
        camera = replace(with_pixels(view, 96, 64), fx=focal, fy=focal)
        drawn = to_bytes(render(decode(fox, int(number / 8 * m.fps) % m.frames), camera).rgb)
        assert np.abs(seen.read(number).astype(int) - drawn).mean() < 4
    assert [file.name for file in tmp_path.iterdir() if file.suffix != ".json"] == ["film.mp4"]


def test_a_path_of_one_view_films_the_scene_once(tmp_path, fox, path):
    place = fox.manifest.region.places[0]
    path.write_text(json.dumps({"keyframes": [{"t": 0, "position": place.position, "focus": place.focus}]}))
    twice = 2 * fox.manifest.fps
    count = film_along(fox, open_path(path, fox.manifest), tmp_path / "film.mp4", (32, 32), twice)
    assert count == 2 * fox.manifest.frames


def test_a_film_that_breaks_off_leaves_what_was_there(tmp_path, fox, path):
    out = tmp_path / "film.mp4"
    out.write_bytes(b"before")

    def interrupt(_what, done, _all):
        if done == 3:
            raise KeyboardInterrupt

    walk = open_path(path, fox.manifest)
    with pytest.raises(KeyboardInterrupt):
        film_along(fox, walk, out, (32, 32), None, (CPU, interrupt))
    assert out.read_bytes() == b"before" and {file.name for file in tmp_path.iterdir()} == {"film.mp4", "path.json"}
    with pytest.raises(CodecError, match="nowhere"):
        film_along(fox, walk, tmp_path / "nowhere" / "film.mp4", (32, 32))


def test_a_path_through_what_it_looks_at_is_refused(tmp_path, fox, path):
    ends = [{"t": 2 * i, "position": [0, 0, z], "focus": [0, 0, -z]} for i, z in enumerate((-1, 1))]
    path.write_text(json.dumps({"keyframes": ends}))
    with pytest.raises(SceneError, match=r"looks nowhere after 1\.000 s"):
        film_along(fox, open_path(path, fox.manifest), tmp_path / "film.mp4", (32, 32), Fraction(4))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ([], "expected --video"),
        (["--video", "f.mp4", "--trace", "const:1"], "no session"),
        (["--video", "f.mp4", "--size", "33x32"], "expected even sides"),
        (["--video", "f.mp4", "--size", "32"], "expected even sides"),
        (["--video", "f.mp4", "--fps", "0"], "--fps: expected"),
    ],
)
def test_what_cannot_be_filmed_is_one_line_and_2(path, capsys, tmp_path, monkeypatch, options, words):
    monkeypatch.chdir(tmp_path)
    assert film(["--path", path, *options]) == 2
    err = capsys.readouterr().err
    assert err.startswith("airgs-play: ") and words in err and err.count("\n") == 1
    assert [file.name for file in tmp_path.iterdir()] == ["path.json"]


def test_what_belongs_to_a_path_is_refused_without_one_and_a_path_over_a_url(path, capsys):
    for options in (["--size", "32x32"], ["--fps", "24"]):
        assert film(["--trace", "const:1", *options]) == 2
        assert f"{options[0]}: expected --path" in capsys.readouterr().err
    assert film(["--path", path, "--video", "f.mp4"], "http://127.0.0.1:1/fox.airgs") == 2
    assert "--path: expected a folder" in capsys.readouterr().err
