"""Films are read again frame by frame; sound of any file is packets of Opus, as long as the pictures, to a sample."""

import io
import struct
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from airgs_codec.media.mp4 import read_samples, read_start, sound_segment
from tests.faces import CodecError, SceneError, VideoReader, decode_sound, encode_sound, write_movie
from tests.support.chirps import chirp, write_chirp
from tests.support.multiview_files import plain, write_video


def test_a_film_of_odd_size_is_read_back_without_its_odd_row_and_column_also_by_threads_together(tmp_path):
    path = tmp_path / "a.mp4"
    write_movie(path, (np.full((33, 47, 3), 40 * t, np.uint8) for t in range(5)), Fraction(24))
    film = VideoReader(path)
    assert (film.size, film.clock.fps, list(film.clock.pictures)) == ((46, 32), 24, [0, 1, 2, 3, 4])
    for number in (3, 1, 1, 4, 0):  # also again and backward
        assert np.abs(film.read(number).astype(int) - 40 * number).mean() < 4
    with pytest.raises(SceneError, match="ends after 5"):
        film.read(5)
    wanted = [0, 4, 3, 1, 2] * 6
    with ThreadPoolExecutor(4) as pool:
        levels = list(pool.map(lambda t: film.read(t).mean() / 40, wanted))
    assert np.rint(levels).tolist() == wanted
    film.close()


def test_what_is_no_film_is_refused_and_a_name_is_never_taken_for_a_protocol(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(CodecError, match="at least one frame"):
        write_movie(Path("a.mp4"), [], Fraction(24))
    write_video(Path("v.mp4"), [plain(20)] * 2)
    Path("file:v.mp4").write_bytes(b"not a film")
    with pytest.raises(SceneError, match=r"file:v\.mp4: expected a video"):
        VideoReader(Path("file:v.mp4"))
    write_video(Path("1.h264"), [plain(20)] * 2)
    write_video(Path("2.h264"), [plain(20, (64, 48))] * 2)
    Path("a.h264").write_bytes(Path("1.h264").read_bytes() + Path("2.h264").read_bytes())
    film = VideoReader(Path("a.h264"))
    assert film.read(1).shape[1::-1] == film.size == (32, 24)
    with pytest.raises(SceneError, match="expected frames of 32x24, got 64x48 at 2"):
        film.read(2)


def rms(samples) -> float:
    return float(np.sqrt((np.asarray(samples, float) ** 2).mean()))


@pytest.mark.parametrize(("rate", "channels"), [(44_100, 2), (48_000, 1), (8_000, 1)])
def test_what_is_decoded_is_what_was_given_at_the_same_sample(tmp_path, rate, channels):
    """A decoder that begins later is right after four packets of 20 ms."""
    track = encode_sound(write_chirp(tmp_path / "a.wav", 2.0, channels, rate), Fraction(2))
    assert (track.channels, len(track.packets), track.note) == (channels, 100, "")
    whole, later = decode_sound(track.packets, channels), decode_sound(track.packets[40:], channels)
    samples = whole[track.pre_skip :] / 32768
    given = chirp(2.0)[: len(samples)]
    assert rms(samples[2000:-2000] - given[2000:-2000, None]) < 0.02
    assert rms(samples[2000:-2000] - given[2008:-1992, None]) > 0.05  # a sixth of a millisecond off
    off = whole[40 * 960 :].astype(int) - later
    assert rms(off[:240]) > 3000 and rms(off[4 * 960 :]) < 300


def test_longer_sound_is_cut_and_shorter_sound_is_followed_by_silence(tmp_path):
    path = write_chirp(tmp_path / "a.wav", 2.0)
    cut, short = encode_sound(path, Fraction(3, 2)), encode_sound(path, Fraction(3))
    assert cut.note == "cut after 1.50 s, where the pictures end" and len(cut.packets) == 75
    assert short.note == "silent after 2.00 of 3.00 s" and len(short.packets) == 150
    samples = decode_sound(short.packets, 1)
    assert rms(samples[:90_000]) > 5000 and rms(samples[100_000:]) < 5


def test_sound_that_begins_later_than_its_film_stays_there(tmp_path):
    path = tmp_path / "a.mkv"
    with av.open(str(path), "w") as film:
        picture, sound = film.add_stream("mpeg4", rate=10), film.add_stream("pcm_s16le", rate=48_000, layout="mono")
        picture.width = picture.height = 64
        for _ in range(10):
            film.mux(picture.encode(av.VideoFrame.from_ndarray(np.full((64, 64, 3), 9, np.uint8), "rgb24")))
        film.mux(picture.encode(None))
        frame = av.AudioFrame.from_ndarray(np.round(32767 * chirp(0.5)).astype(np.int16)[None], "s16", "mono")
        frame.sample_rate, frame.pts, frame.time_base = 48_000, 19_200, Fraction(1, 48_000)
        film.mux(sound.encode(frame))
        film.mux(sound.encode(None))
    track = encode_sound(path, Fraction(1))
    samples = decode_sound(track.packets, 1)[track.pre_skip :, 0] / 32768
    assert rms(samples[:19_000]) < 1e-3 and rms(samples[22_000:40_000] - chirp(0.5)[2800:20_800]) < 0.02


def test_fragments_are_what_ffmpeg_plays(tmp_path):
    track = encode_sound(write_chirp(tmp_path / "a.wav", 1.0), Fraction(1))
    parts = [sound_segment(track.packets[:20], 0), sound_segment(track.packets[20:], 20)]
    assert [read_start(part) for part in parts] == [0, 20 * 960]
    assert read_samples(parts[1]) == track.packets[20:]
    with av.open(io.BytesIO(b"".join([track.init, *parts]))) as film:
        samples = np.concatenate([frame.to_ndarray()[0] for frame in film.decode(audio=0)])
    assert len(samples) == 48_000 - track.pre_skip
    assert rms(samples[2000:-2000] - chirp(1.0)[2000 : len(samples) - 2000]) < 0.02


def test_what_has_no_sound_is_refused_in_one_line(tmp_path):
    (tmp_path / "text").write_text("no sound")
    write_movie(tmp_path / "mute.mp4", [np.zeros((32, 32, 3), np.uint8)], Fraction(10))
    empty = struct.pack("<4sI8sIHHIIHH4sI", b"RIFF", 136, b"WAVEfmt ", 16, 1, 0, 48_000, 0, 0, 16, b"data", 100)
    (tmp_path / "empty.wav").write_bytes(empty + bytes(100))
    write_chirp(tmp_path / "short.wav", 0.1)
    for name, seconds, says in (
        ("text", 1, "a file with sound"), ("mute.mp4", 1, "without"), ("gone", 1, "No such file"),
        ("empty.wav", 1, "channels"), ("short.wav", 10**6, "at most 21600 s"),
    ):  # fmt: skip
        with pytest.raises(SceneError, match=says) as refused:
            encode_sound(tmp_path / name, Fraction(seconds))
        assert "\n" not in str(refused.value) and name in str(refused.value)
    with pytest.raises(CodecError, match="cannot be decoded"):
        decode_sound([b"\xff\xff\xff\xff"], 1)
