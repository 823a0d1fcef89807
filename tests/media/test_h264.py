"""H.264: every closed GOP decodes alone, and errors are what the QP allows."""

from fractions import Fraction

import numpy as np
import pytest

from airgs_codec.errors import CodecError, FormatError
from airgs_codec.media.h264 import (
    KEY_QP,
    STATE_QP,
    ClosedGop,
    CodecSettings,
    check_stream,
    decode_pictures,
    encode_stream,
    qp_step,
)


def pictures(count, seed=0, width=96, height=64):
    rng = np.random.default_rng(seed)
    still = rng.integers(60, 200, (height, width))
    return [(still + 3 * t + rng.integers(-2, 3, still.shape)).clip(0, 255).astype(np.uint8) for t in range(count)]


@pytest.mark.parametrize("preset", ["ultrafast", "veryslow"])
def test_every_closed_gop_decodes_alone_and_completely(preset):
    gops = [pictures(12), pictures(7, 1), pictures(1, 2)]
    starts = [0, 12000, 30000]  # a gap before the last
    coded = encode_stream(
        [ClosedGop(g, s, 1000) for g, s in zip(gops, starts, strict=True)],
        (96, 64),
        Fraction(24),
        24000,
        CodecSettings(STATE_QP, 1.4, 1.3, preset),
    )
    assert len(coded.media) == 3
    for gop, media, sizes in zip(gops, coded.media, coded.picture_bytes, strict=True):
        decoded = [luma.copy() for luma in decode_pictures(coded.init, media, "x")]
        assert len(decoded) == len(gop) == len(sizes)
        assert sum(sizes) <= len(media)
        for a, b in zip(decoded, gop, strict=True):
            error = np.abs(a.astype(int) - b)
            assert error.max() <= 4 * qp_step(STATE_QP) and error.mean() <= qp_step(STATE_QP) / 2
    assert coded.codecs.startswith("avc1.")


def test_the_stream_carries_no_encoder_banner():
    coded = encode_stream([ClosedGop(pictures(2), 0, 1)], (96, 64), Fraction(24), 24, CodecSettings(KEY_QP, 1.0, 1.0))
    assert b"x264" not in coded.init + coded.media[0]


def test_broken_bytes_are_refused():
    coded = encode_stream([ClosedGop(pictures(3), 0, 1)], (96, 64), Fraction(24), 24, CodecSettings(KEY_QP, 1.0, 1.0))
    for init, media in ((b"", coded.media[0]), (coded.init, b"moof?"), (coded.init[:100], coded.media[0])):
        with pytest.raises(FormatError) as caught:
            if not list(decode_pictures(init, media, "x")):
                raise FormatError("bad_picture", "x", "no picture")
        assert caught.value.reason == "bad_picture"


def test_a_stream_that_decodes_to_something_else_is_not_published():
    codec = CodecSettings(STATE_QP, 1.2, 1.3, "veryfast")
    right, wrong = pictures(4), pictures(4, 5)
    stream = encode_stream([ClosedGop(right, 0, 1)], (96, 64), Fraction(24), 24, codec)
    check_stream(stream, [ClosedGop(right, 0, 1)], codec)
    for other in (wrong, right[:3], [*right, right[0]], [p[:32] for p in right]):
        with pytest.raises(CodecError, match="segment 0"):
            check_stream(stream, [ClosedGop(other, 0, 1)], codec)
