"""Sound of any file as packets of Opus: as long as the pictures, sample for sample in time."""

import io
import struct
from fractions import Fraction

import av
import numpy as np
import pytest

from airgs_codec.media.mp4 import PACKET_TICKS, WARM_UP, read_samples, read_start, sound_segment
from airgs_codec.media.sound import decode_sound
from tests.faces import CodecError, SceneError, encode_sound, write_movie
from tests.support.chirps import chirp, write_chirp


def rms(samples) -> float:
    return float(np.sqrt((np.asarray(samples, float) ** 2).mean()))


@pytest.mark.parametrize(("rate", "channels"), [(44_100, 2), (48_000, 1), (8_000, 1)])
def test_what_is_decoded_is_what_was_given_at_the_same_sample(tmp_path, rate, channels):
    track = encode_sound(write_chirp(tmp_path / "a.wav", 2.0, channels, rate), Fraction(2))
    assert (track.channels, len(track.packets), track.note) == (channels, 100, "")
    samples = decode_sound(track.packets, channels)[track.pre_skip :] / 32768
    given = chirp(2.0)[: len(samples)]
    assert rms(samples[2000:-2000] - given[2000:-2000, None]) < 0.02
    assert rms(samples[2000:-2000] - given[2008:-1992, None]) > 0.05  # a sixth of a millisecond off


def test_a_decoder_that_begins_later_is_right_after_four_packets(tmp_path):
    track = encode_sound(write_chirp(tmp_path / "a.wav", 2.0), Fraction(2))
    whole, later = decode_sound(track.packets, 1), decode_sound(track.packets[40:], 1)
    off = whole[40 * PACKET_TICKS :].astype(int) - later
    assert rms(off[: PACKET_TICKS // 4]) > 3000 and rms(off[WARM_UP * PACKET_TICKS :]) < 300


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
    assert [read_start(part) for part in parts] == [0, 20 * PACKET_TICKS]
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
    cases = (
        ("text", "a file with sound"),
        ("mute.mp4", "without"),
        ("gone", "No such file"),
        ("empty.wav", "channels"),
    )
    for name, words in (*cases, ("short.wav", "at most 21600 s")):
        with pytest.raises(SceneError, match=words) as refused:
            encode_sound(tmp_path / name, Fraction(10**6 if name == "short.wav" else 1))
        assert "\n" not in str(refused.value) and name in str(refused.value)
    with pytest.raises(CodecError, match="cannot be decoded"):
        decode_sound([b"\xff\xff\xff\xff"], 1)
