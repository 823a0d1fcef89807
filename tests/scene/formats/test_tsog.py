"""TSOG and FTGS by their specifications: hand-made files are decoded to what they say, broken ones are refused.

No published file is here, for their repository has another licence; these are made by TSOG-SPEC.md and FORMAT.md.
"""

import json
import math
import pickle
import zipfile
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

import airgs_codec as airgs
from airgs_codec.cli import decode, encode
from airgs_codec.errors import SceneError
from airgs_codec.media.image import encode_webp
from airgs_codec.media.sound import decode_sound, encode_sound
from airgs_codec.scene.formats.form import Losses
from airgs_codec.scene.formats.ftgs import FTGS
from airgs_codec.scene.formats.moving import Moving
from airgs_codec.scene.formats.tsog import TSOG
from airgs_codec.scene.formats.tsog_write import write_tsog
from airgs_codec.scene.gaussians import sigmoid
from airgs_codec.scene.sequence import open_sequence
from tests.support.chirps import moment, write_chirping
from tests.support.clip_files import discrete, tone, tsog_bytes, write_ftgs
from tests.support.paths import GOLDEN
from tests.support.scenes import random_gaussians

FPS = 24.0
QUICK = ("--x264-preset", "ultrafast", "--calibrate", "none", "--measure-pictures", "0")


@pytest.fixture
def opened(tmp_path):
    def open_it(*change, **more):
        (tmp_path / "a.tsog").write_bytes(tsog_bytes(*change, **more))
        return open_sequence(tmp_path / "a.tsog")

    return open_it


def set_to(path, value):
    """A change of meta.json: the entry at a path of names is another."""

    def change(meta):
        *names, last = path.split(".")
        for name in names:
            meta = meta.setdefault(name, {})
        meta[last] = value

    return change


def test_gaussians_move_and_fade_from_their_centres(opened):
    sequence = opened()
    assert (len(sequence), sequence.fps, sequence.sh_degree) == (5, 2, 1)  # both ends, as the specification counts
    for frame, t in ((0, 0.0), (2, 0.5), (4, 1.0)):
        g = sequence.read(frame)
        np.testing.assert_allclose(g.means, [[-1 + 2 * (t - 0.25), 0, 1], [1 - 2 * (t - 0.75), 0, 1]], atol=1e-6)
        fade = np.exp(-0.5 * ((t - np.array([0.25, 0.75])) / 0.5) ** 2)
        np.testing.assert_allclose(g.opacities(), np.clip([128 / 255, 1] * fade, 0, 1019 / 1020), atol=1e-6)
    np.testing.assert_allclose(g.sh_dc, [[0, 1, -1], [-1, 0, 1]])
    np.testing.assert_allclose(g.sh_rest, [[[0.5, -0.5, 0]] * 3, [[-0.5, 0, 0.5]] * 3])
    np.testing.assert_allclose(np.abs(g.quaternions), [[1, 0, 0, 0], [0, 0, 0, 1]], atol=0.01)
    assert not g.log_scales.any() and len(pickle.dumps(sequence)) < 3000


def test_how_long_a_clip_is_by_what_its_file_says(opened, tmp_path):
    assert len(opened(set_to("playback", {}))) == 300  # 299 intervals
    assert "by default" in opened(set_to("playback", {})).clip.note
    opened(set_to("playback", {}))
    assert len(open_sequence(tmp_path / "a.tsog", bake_fps=10, duration=1)) == 11
    opened()
    assert len(open_sequence(tmp_path / "a.tsog", bake_fps=Fraction(5))) == 11
    with pytest.raises(SceneError, match="expected no duration"):
        open_sequence(tmp_path / "a.tsog", duration=1)
    assert "to be played at 2 times its speed" in opened(set_to("playback.rate", 2)).clip.note


def test_velocities_of_16_bits_and_none(opened):
    low, high = (encode_webp(np.array([[[byte, 0, 0, 255]] * 2], np.uint8)) for byte in (1, 2))
    temporal = {"means": {"mins": [[0, 0, 0]], "maxs": [[65535, 0, 0]], "files": ["v", "w"]}}
    first = opened(set_to("temporal", temporal), v=low, w=high).read(0)
    np.testing.assert_allclose(first.means[:, 0], [-1 - 513 * 0.25, 1 - 513 * 0.75])
    still = opened(lambda meta: meta.pop("temporal"))
    np.testing.assert_array_equal(still.read(0).means, still.read(4).means)


def test_a_discrete_file_shows_every_gaussian_in_its_frame(opened, tmp_path):
    sequence = opened(discrete(3, fps=12))
    assert (len(sequence), sequence.fps) == (3, 12) and sequence.clip.note.startswith(".tsog, discrete: 1 Gaussians")
    assert [sequence.read(i).means[0, 0] for i in (0, 2)] == pytest.approx([-1, 1], abs=1e-6)
    np.testing.assert_allclose(sequence.read(0).opacities(), 128 / 255, atol=1e-6)  # it does not fade
    assert sequence.read(1).opacities() < 1 / 255  # nobody is in it
    assert opened(discrete(4, duration=2)).fps == 2
    with pytest.raises(SceneError, match="expected no frame rate"):
        open_sequence(tmp_path / "a.tsog", bake_fps=10)


def test_a_still_file_is_one_frame_or_as_long_as_it_says(opened):
    def still(meta):
        del meta["timeline"], meta["temporal"]
        meta["playback"] = {}

    assert len(opened(still)) == 1
    sequence = opened(lambda meta: (still(meta), meta.update(playback={"duration": 2, "fps": 3})))
    assert (len(sequence), sequence.fps) == (6, 3)
    np.testing.assert_allclose(sequence.read(5).opacities(), [128 / 255, 1019 / 1020], atol=1e-6)


REFUSED = {
    "version": (set_to("version", 2), "version 4"),
    "no number": (set_to("version", True), "version 4"),
    "profile": (set_to("profile.version", 2), "profile"),
    "count": (set_to("count", 1.5), "count: expected a whole number"),
    "many": (set_to("count", 10**12), "can hold"),
    "rows": (set_to("count", 3), "3 Gaussians in pictures of one size, got 2 x 1"),
    "book": (set_to("sh0.codebook", [1e39, 0, 0]), "float32"),
    "short book": (set_to("sh0.codebook", [0.0]), "out of bounds"),
    "no numbers": (set_to("scales.codebook", ["0"]), "codebook of scales: expected a number"),
    "reversed": (set_to("means.mins", [1, 1, 1]), "at most maxs"),
    "label": (set_to("shN.count", 1), "out of bounds"),
    "bands": (set_to("shN.bands", 2), "a palette of"),
    "names": (set_to("quats.files", ["../quats"]), "within the archive"),
    "twice": (set_to("means.files", ["low", "low"]), "expected 2 names"),
    "missing": (set_to("quats.files", ["none"]), "no 'none'"),
    "deviation": (set_to("timeline.mins", [0, 0]), "above 0"),
    "kind": (set_to("timeline.type", 2), "type of the timeline"),
    "delta": (lambda m: (discrete(3)(m), set_to("timeline.delta", 1)(m)), "delta"),
    "length": (discrete(4, duration=2, fps=3), "to be 4 frames"),
    "turning": (set_to("temporal.quats", {}), "positions alone"),
    "order": (set_to("temporal.means.mins", [[0, 0, 0]] * 2), "first order"),
    "rate": (set_to("playback.rate", 5), "0.25 to 4"),
    "endless": (set_to("playback", {"duration": 1e300, "fps": 1e2}), "1 to 262144 frames"),
    "sound": (set_to("audio", {"file": "sound.bin"}), "a kind of sound"),
    "shared": (set_to("audio", {"file": "quats", "mimeType": "audio/wav"}), "a file of its own"),
    "loud": (set_to("audio", {"file": "a.wav", "volume": 2}), "a volume"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_a_reader_must_not_guess_at_is_refused(opened, case):
    change, says = REFUSED[case]
    with pytest.raises(SceneError, match=says) as caught:
        opened(change).read(0)
    assert "a.tsog: expected" in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("data", [b"", b"PK", tsog_bytes()[:-30], tsog_bytes(low=b"RIFF....WEBPVP8 " + bytes(40))])
def test_what_is_no_tsog_or_lossy_is_refused(tmp_path, data):
    (tmp_path / "a.tsog").write_bytes(data)
    with pytest.raises(SceneError, match=r"a\.tsog: expected"):
        open_sequence(tmp_path / "a.tsog").read(0)


def test_its_sound_goes_into_the_package(opened, tmp_path, capsys):
    sequence = opened(set_to("audio", {"file": "audio/tone.wav", "volume": 0.5}), **{"audio/tone.wav": tone(1)})
    assert sequence.sound() == tone(1)
    assert encode.main([str(tmp_path / "a.tsog"), "-o", str(tmp_path / "out.airgs"), *QUICK]) == 0
    assert "sound from audio/tone.wav, to be played at 0.5 of its volume" in capsys.readouterr().out
    manifest = airgs.open_package(tmp_path / "out.airgs").manifest
    assert manifest.sound is not None and airgs.validate(tmp_path / "out.airgs") == []
    with pytest.raises(SceneError, match="sound in audio/none"):
        opened(set_to("audio", {"file": "audio/none.mp3"})).sound()


@pytest.mark.parametrize("degree", [0, 1, 3])
def test_frames_are_written_discretely_and_come_back_within_a_step(tmp_path, degree):
    frames = [random_gaussians(300, degree, seed=seed) for seed in (1, 2)] + [random_gaussians(40, degree)]
    losses = Losses(TSOG.holds, TSOG.name)
    frames = [losses.fit(g, "a frame") for g in frames]
    TSOG.write(tmp_path / "a.tsog", frames, FPS)
    sequence = open_sequence(tmp_path / "a.tsog")
    assert (len(sequence), sequence.fps, sequence.sh_degree) == (3, 24, degree)
    logs = np.concatenate([np.sign(g.means) * np.log1p(np.abs(g.means)) for g in frames])
    for i, g in enumerate(frames):
        back = sequence.read(i)
        step = np.exp(np.abs(logs).max()) * np.ptp(logs, axis=0) / 65535 / 2
        assert len(back) == len(g) and (np.abs(back.means - g.means) <= step + 1e-6).all()
        assert np.abs(back.opacities() - g.opacities()).max() <= 0.5 / 255 + 1e-6
        assert np.abs((back.quaternions * g.quaternions).sum(axis=1)).min() > 0.9999
        for name in ("log_scales", "sh_dc"):  # 256 levels that are fitted are better than even ones
            errors = getattr(back, name) - getattr(g, name)
            assert np.sqrt(np.square(errors).mean()) <= np.ptp(getattr(g, name)) / 255 / 2
        # 640 rows are less than the palette holds
        assert np.abs(back.sh_rest - g.sh_rest).max(initial=0) <= np.ptp(g.sh_rest) / 64 if degree else True
    with zipfile.ZipFile(tmp_path / "a.tsog") as archive:
        meta = json.loads(archive.read("meta.json"))
    assert meta["profile"]["version"] == 1 and meta["timeline"]["N"] == 3


def test_a_palette_of_more_rows_than_it_holds_keeps_the_nearest(tmp_path):
    clusters = np.repeat(random_gaussians(32, 1).sh_rest, 100, axis=0)
    g = replace(random_gaussians(3200, 1), sh_rest=clusters + np.float32(1e-3) * random_gaussians(3200, 1).sh_rest)
    write_tsog(tmp_path / "a.tsog", [Losses(TSOG.holds, "").fit(g, "a")], FPS, levels=32, palette=64)
    back = open_sequence(tmp_path / "a.tsog").read(0)
    assert len(np.unique(back.sh_rest, axis=0)) <= 64 and len(np.unique(back.sh_dc)) <= 32
    assert np.abs(back.sh_rest - g.sh_rest).max() < np.ptp(clusters) / 20


def test_a_decoded_package_is_written_as_tsog_by_its_name(tmp_path):
    assert decode.main([str(GOLDEN / "fox"), "-o", str(tmp_path / "b.tsog"), "--frames", "0:3"]) == 0
    back, package = open_sequence(tmp_path / "b.tsog"), airgs.open_package(GOLDEN / "fox")
    assert (len(back), back.fps) == (3, package.manifest.fps)
    np.testing.assert_allclose(back.read(2).means, airgs.decode(package, 2).means, atol=1e-3)


def drifting(frames, degree=1):
    """Rows that move evenly, of which some appear and fade and others stay; what they are at 0 and do until 1."""
    rng, g = np.random.default_rng(3), random_gaussians(200, degree)
    g = replace(g, opacity_logits=rng.uniform(-1, 4, 200).astype(np.float32))
    speed = rng.normal(size=(200, 3)).astype(np.float32)
    centres, widths = rng.uniform(0, 1, 200).astype(np.float32), rng.uniform(0.2, 1, 200).astype(np.float32)
    widths[::2] = 100.0
    moving = Moving(
        replace(g, means=g.means + speed * centres[:, None]), speed[:, None], g.opacities(), centres, widths
    )
    losses = Losses(FTGS.holds, FTGS.name)
    return [losses.fit(moving.at(t), "a frame") for t in np.linspace(0, 1, frames)]


@pytest.mark.parametrize(
    ("name", "form", "place", "alpha"), [("a.tsog", TSOG, 2e-4, 0.004), ("a.ply", FTGS, 1e-4, 0.002)]
)
@pytest.mark.parametrize("frames", [2, 3, 12])
def test_what_moves_evenly_is_written_once_and_comes_back(tmp_path, name, form, place, alpha, frames):
    given = drifting(frames)
    form.write(tmp_path / name, given, FPS)
    sequence = open_sequence(tmp_path / name)
    assert len(sequence) == frames and "200 Gaussians baked" in sequence.clip.note
    for i, g in enumerate(given):
        back = sequence.read(i)
        seen = g.opacities() > 1 / 255
        assert np.abs(back.opacities() - g.opacities()).max() <= alpha
        np.testing.assert_allclose(back.means[seen], g.means[seen], atol=place)


def test_what_does_not_move_evenly_is_refused_by_ftgs_and_discrete_in_tsog(tmp_path):
    frames = [random_gaussians(50, 1, seed=seed) for seed in (1, 2, 3)]
    with pytest.raises(SceneError, match=r"\d+% that do otherwise"):
        FTGS.write(tmp_path / "a.ply", frames, FPS)
    with pytest.raises(SceneError, match="others from frame to frame"):
        FTGS.write(tmp_path / "a.ply", [*frames, random_gaussians(20, 1)], FPS)
    assert not list(tmp_path.iterdir())


def test_the_sound_of_a_package_is_in_the_tsog_of_all_its_frames(tmp_path, capsys):
    package = write_chirping(tmp_path, 50, Fraction(25), 25)
    assert decode.main([str(package), "-o", str(tmp_path / "a.tsog")]) == 0
    track = encode_sound(tmp_path / "a.tsog", Fraction(2), open_sequence(tmp_path / "a.tsog").sound())
    heard = decode_sound(track.packets, track.channels)[track.pre_skip :, 0]
    assert moment(heard[60_000:64_800]) == pytest.approx(1.3, abs=0.01)  # of the second file
    assert decode.main([str(package), "-o", str(tmp_path / "b.tsog"), "--frames", "0:3"]) == 0
    assert "without its sound" in capsys.readouterr().out and open_sequence(tmp_path / "b.tsog").sound() is None
    assert decode.main([str(package), "-o", str(tmp_path / "a.4dgs")]) == 0
    assert ".4dgs has no sound" in capsys.readouterr().out


def test_a_refusal_names_the_file_that_was_asked_for(tmp_path, capsys):
    assert decode.main([str(GOLDEN / "fox"), "-o", str(tmp_path / "a.ftgs.ply")]) == 2
    assert f"{tmp_path / 'a.ftgs.ply'}: expected Gaussians that move evenly" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_ftgs_is_evaluated_as_its_format_says(tmp_path):
    sequence = open_sequence(write_ftgs(tmp_path / "a.ftgs.ply", n_frames=5))
    assert (len(sequence), sequence.fps, sequence.sh_degree) == (5, 30, 1) and "default" not in sequence.clip.note
    g = sequence.read(3)  # t = 0.75
    np.testing.assert_allclose(g.means, [[n + 0.5, 0, 0] for n in range(4)])
    np.testing.assert_allclose(g.opacities(), 0.5 * math.exp(-0.5 * 2.5**2), atol=1e-6)
    np.testing.assert_allclose(g.sh_rest[0], [[1, 4, 7], [2, 5, 8], [3, 6, 9]])
    np.testing.assert_allclose(np.exp(g.log_scales[0]), [1, 2, 3], rtol=1e-6)
    assert sequence.read(0).opacities()[0] == pytest.approx(sigmoid(np.float32(-math.log(1019))))


def test_ftgs_settings_are_kept(tmp_path):
    wide = open_sequence(write_ftgs(tmp_path / "a.ply", min_duration=0.25, n_frames=3, opacity_floor=0.4)).read(1)
    np.testing.assert_allclose(wide.opacities(), 0.5, atol=1e-6)
    ends = open_sequence(tmp_path / "a.ply").read(0)
    np.testing.assert_allclose(ends.opacities(), 0.4, atol=1e-6)  # exp(-2) of 0.5 is below the floor
    still = open_sequence(write_ftgs(tmp_path / "b.ply", degree=0, use_velocity=0))
    assert len(still) == 300 and "by default" in still.clip.note
    np.testing.assert_array_equal(still.read(0).means, still.read(299).means)


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"ftgs_version": 2}, "version 1"),
        ({"time_units": "seconds"}, "normalized"),
        ({"sh_degree": 4}, "sh_degree from 0 to 3"),
        ({"sh_degree": 2}, "missing f_rest_9"),
        ({"use_velocity": "yes"}, "could not convert"),
        ({"min_duration": 0}, "min_duration"),
        ({"opacity_floor": 1}, "opacity_floor"),
        ({"opacity_floor": None}, "opacity_floor"),
        ({"n_frames": 1.5}, "n_frames"),
        ({"n_frames": 10**9}, "n_frames"),
        ({"n_frames": "nan"}, "n_frames"),
    ],
)
def test_a_broken_ftgs_is_refused(tmp_path, settings, says):
    with pytest.raises(SceneError, match=says) as caught:
        open_sequence(write_ftgs(tmp_path / "a.ftgs.ply", **settings))
    assert "\n" not in str(caught.value)
