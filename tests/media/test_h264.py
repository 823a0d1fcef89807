"""H.264: every closed GOP decodes alone, and errors are what the QP allows."""

import random
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from airgs_codec.media.h264 import (
    KEY_QP,
    STATE_QP,
    ClosedGop,
    CodecSettings,
    Pictures,
    check_gop,
    encode_gop,
    in_range,
    key_codec,
    open_segment,
    qp_step,
    state_codec,
)
from airgs_codec.media.mp4 import init_segment, read_samples
from tests.faces import CodecError, FormatError
from tests.support.bitstream import trace_headers

SIZE = (96, 64)


def pictures(count, seed=0, width=96, height=64):
    rng = np.random.default_rng(seed)
    still = rng.integers(60, 200, (height, width))
    return [(still + 3 * t + rng.integers(-2, 3, still.shape)).clip(0, 255).astype(np.uint8) for t in range(count)]


@pytest.mark.parametrize("preset", ["ultrafast", "veryslow"])
def test_every_closed_gop_decodes_alone_and_completely(preset):
    gops = [pictures(12), pictures(7, 1), pictures(1, 2)]
    codec = CodecSettings(STATE_QP, 1.3, preset)
    for gop in gops:
        coded = encode_gop(ClosedGop(gop, 12000, 1000), SIZE, Fraction(24), codec)
        decoded = list(coded.pictures("x"))
        assert len(decoded) == len(gop) == len(coded.picture_bytes)
        assert sum(coded.picture_bytes) <= len(coded.fragment)
        for a, b in zip(decoded, gop, strict=True):
            error = np.abs(a.astype(int) - b)
            assert error.max() <= 4 * qp_step(STATE_QP) and error.mean() <= qp_step(STATE_QP) / 2


def test_the_stream_carries_no_encoder_banner():
    coded = encode_gop(ClosedGop(pictures(2), 0, 1), SIZE, Fraction(24), CodecSettings(KEY_QP, 1.0))
    assert b"x264" not in coded.fragment


def test_broken_bytes_are_refused():
    coded = encode_gop(ClosedGop(pictures(3), 0, 1), SIZE, Fraction(24), CodecSettings(KEY_QP, 1.0))
    with pytest.raises(FormatError) as caught:
        open_segment(b"moof?", "x")
    assert caught.value.reason == "bad_picture"
    whole = read_samples(coded.fragment)
    for samples in (whole[1:], [whole[0][:-1]], [b"\0\0\0\1\x65"]):
        with pytest.raises(FormatError) as caught:
            if len(list(Pictures(samples, "x"))) < len(whole):
                raise FormatError("bad_picture", "x", "no picture")
        assert caught.value.reason == "bad_picture"


@pytest.mark.parametrize("codec", [key_codec("veryfast"), state_codec("veryslow")])
def test_no_flipped_bit_changes_a_picture(codec):
    """FFmpeg conceals most damage, and some H.264 is as good after it: the checksums tell."""
    gop = ClosedGop(pictures(6 if codec.between else 1), 0, 1)
    coded = encode_gop(gop, SIZE, Fraction(24), codec)
    coded = replace(coded, checksums=check_gop(coded, gop, codec).checksums)
    whole, right = read_samples(coded.fragment), list(coded.pictures("x"))
    chance, refused = random.Random(1), 0
    for _ in range(200):
        number = chance.randrange(len(whole))
        sample, bit = bytearray(whole[number]), chance.randrange(8 * len(whole[number]))
        sample[bit // 8] ^= 1 << bit % 8
        damaged = [*whole[:number], bytes(sample), *whole[number + 1 :]]
        try:
            shown = list(Pictures(damaged, "x", checksums=coded.checksums))
        except FormatError as error:
            assert error.reason == "bad_picture"
            refused += 1
            continue
        assert all(map(np.array_equal, shown, right))  # fewer pictures are refused by who counts them
    assert refused > 150


def test_a_stream_that_decodes_to_something_else_is_not_published():
    codec = CodecSettings(STATE_QP, 1.3, "veryfast")
    right, wrong = pictures(4), pictures(4, 5)
    coded = encode_gop(ClosedGop(right, 0, 1), SIZE, Fraction(24), codec)
    check_gop(coded, ClosedGop(right, 0, 1), codec)
    for other in (wrong, right[:3], [*right, right[0]], [p[:32] for p in right]):
        with pytest.raises(CodecError, match="segment at 7 ticks"):
            check_gop(coded, ClosedGop(other, 7, 1), codec)


@pytest.mark.parametrize(("codec", "reordered"), [(key_codec("veryslow"), 0), (state_codec("veryslow"), 2)])
def test_the_stream_says_what_a_decoder_must_hold(codec, reordered):
    """Without that in the VUI some decoders hold 16 pictures back."""
    gop = ClosedGop(pictures(9 if codec.between else 1), 0, 1000)
    coded = encode_gop(gop, SIZE, Fraction(24), codec)
    sps = trace_headers(init_segment(24000, 64, 64) + coded.fragment)
    assert sps["bitstream_restriction_flag"] == 1
    assert sps["max_num_reorder_frames"] == reordered
    assert reordered <= sps["max_dec_frame_buffering"] == sps["max_num_ref_frames"] <= (16 if codec.between else 1)
    assert sps["video_full_range_flag"] == 1


@pytest.mark.parametrize("codec", [key_codec("ultrafast"), state_codec("veryslow")])
@pytest.mark.parametrize(("size", "rate"), [((3072, 3072), 24), ((2048, 2048), 120)])
def test_no_level_is_higher_than_decoders_have(codec, size, rate):
    """16 reference pictures of 36,864 macroblocks would be level 6, 120 pictures of 2048x2048 a second level 5.2."""
    grey = np.full(size[::-1], 128, np.uint8)
    coded = encode_gop(ClosedGop([grey], 0, 1000), size, Fraction(rate), codec)
    sps = trace_headers(init_segment(24000, 64, 64) + coded.fragment)
    assert sps["level_idc"] <= 51
    assert sps["max_dec_frame_buffering"] * size[0] * size[1] // 256 <= 184_320


def test_samples_outside_the_limited_range_are_noticed_wherever_they_are():
    """One sample does: in one corner of one picture."""
    codec = state_codec("veryfast")
    for corner, inside in ((128, True), (5, False), (250, False)):
        gop = [np.full((64, 96), 128, np.uint8) for _ in range(3)]
        gop[1][-8:, -8:] = corner
        closed = ClosedGop(gop, 0, 1)
        assert check_gop(encode_gop(closed, SIZE, Fraction(24), codec), closed, codec).in_range == inside


def test_the_range_is_that_of_limited_pictures():
    for low, high, inside in ((16, 235, True), (15, 235, False), (16, 236, False)):
        assert in_range(np.array([[low, high]], np.uint8)) == inside
