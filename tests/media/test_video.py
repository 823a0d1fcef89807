"""Atlases and H.264: samples find their cell, every clip decodes alone, errors are what the QP allows."""

from fractions import Fraction

import numpy as np
import pytest

from airgs_codec.coding import atlas as at
from airgs_codec.errors import CodecError, FormatError
from airgs_codec.media.video import (
    KEY_QP,
    STATE_QP,
    Clip,
    CodecSettings,
    check_stream,
    decode_clip,
    encode_stream,
    quantiser,
    write_movie,
)
from airgs_codec.package.tables import Atlas


@pytest.mark.parametrize("rows", [1, 2, 255, 256, 257, 511, 4096, 5000])
@pytest.mark.parametrize("planes", [1, 3, 19])
def test_samples_come_back_from_their_cells(rows, planes):
    width, columns = at.choose_layout(rows, planes)
    layout = Atlas(rows, [0] * planes, list(range(planes)), width, columns)
    size = at.picture_size(layout)
    assert size[0] >= 64 and size[1] >= 64 and size[0] % 16 == 0 and size[1] % 16 == 0
    samples = np.random.default_rng(0).integers(0, 256, (2, planes, rows)).astype(np.uint8)
    pictures = at.assemble(samples, layout, *size)
    for picture, expected in zip(pictures, samples, strict=True):
        np.testing.assert_array_equal(at.extract(picture, layout), expected)
    larger = at.assemble(samples, layout, size[0] + 32, size[1] + 64)
    np.testing.assert_array_equal(at.extract(larger[1], layout), samples[1])


def test_a_block_is_filled_along_a_z_curve():
    layout = Atlas(300, [0], [0], 32, 1)
    index = at.sample_index(300, 32, 1, 1, 64)[0]
    assert [divmod(int(i), 64) for i in index[:5]] == [(0, 0), (0, 1), (1, 0), (1, 1), (0, 2)]
    assert divmod(int(index[256]), 64) == (0, 16)  # the next block is to the right
    assert at.picture_size(layout) == (64, 64)


def pictures(count, seed=0, width=96, height=64):
    rng = np.random.default_rng(seed)
    still = rng.integers(60, 200, (height, width))
    return [(still + 3 * t + rng.integers(-2, 3, still.shape)).clip(0, 255).astype(np.uint8) for t in range(count)]


@pytest.mark.parametrize("preset", ["ultrafast", "veryslow"])
def test_every_clip_decodes_alone_and_completely(preset):
    clips = [pictures(12), pictures(7, 1), pictures(1, 2)]
    starts = [0, 12000, 30000]  # a gap before the last
    coded = encode_stream(
        [Clip(c, s, 1000) for c, s in zip(clips, starts, strict=True)],
        (96, 64),
        Fraction(24),
        24000,
        CodecSettings(STATE_QP, 1.4, 1.3, preset),
    )
    assert len(coded.media) == 3
    for clip, media, sizes in zip(clips, coded.media, coded.picture_bytes, strict=True):
        decoded = [luma.copy() for luma in decode_clip(coded.init, media, "x")]
        assert len(decoded) == len(clip) == len(sizes)
        assert sum(sizes) <= len(media)
        for a, b in zip(decoded, clip, strict=True):
            error = np.abs(a.astype(int) - b)
            assert error.max() <= 4 * quantiser(STATE_QP) and error.mean() <= quantiser(STATE_QP) / 2
    assert coded.codecs.startswith("avc1.")


def test_the_stream_carries_no_encoder_banner():
    coded = encode_stream([Clip(pictures(2), 0, 1)], (96, 64), Fraction(24), 24, CodecSettings(KEY_QP, 1.0, 1.0))
    assert b"x264" not in coded.init + coded.media[0]


def test_broken_bytes_are_refused():
    coded = encode_stream([Clip(pictures(3), 0, 1)], (96, 64), Fraction(24), 24, CodecSettings(KEY_QP, 1.0, 1.0))
    for init, media in ((b"", coded.media[0]), (coded.init, b"moof?"), (coded.init[:100], coded.media[0])):
        with pytest.raises(FormatError) as caught:
            if not list(decode_clip(init, media, "x")):
                raise FormatError("bad_picture", "x", "no picture")
        assert caught.value.reason == "bad_picture"


def test_a_film_of_odd_size_can_be_written(tmp_path):
    write_movie(tmp_path / "a.mp4", (np.zeros((33, 47, 3), np.uint8) for _ in range(3)), Fraction(24))
    assert (tmp_path / "a.mp4").stat().st_size > 500


def test_a_stream_that_decodes_to_something_else_is_not_published():
    codec = CodecSettings(STATE_QP, 1.2, 1.3, "veryfast")
    right, wrong = pictures(4), pictures(4, 5)
    stream = encode_stream([Clip(right, 0, 1)], (96, 64), Fraction(24), 24, codec)
    check_stream(stream, [Clip(right, 0, 1)], codec)
    for other in (wrong, right[:3], [*right, right[0]], [p[:32] for p in right]):
        with pytest.raises(CodecError, match="segment 0"):
            check_stream(stream, [Clip(other, 0, 1)], codec)
