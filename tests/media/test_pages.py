"""Pages: pictures that are too large for decoders come back whole, and a single decoder is enough for them."""

import io
import struct
from dataclasses import replace
from fractions import Fraction

import av
import numpy as np
import pytest

from airgs_codec.media.h264 import (
    STATE_QP,
    ClosedGop,
    Pictures,
    check_gop,
    encode_gop,
    open_segment,
    qp_step,
    state_codec,
)
from airgs_codec.media.mp4 import init_segment, read_boxes, read_samples, read_start, start_codes
from tests.faces import FormatError

SIZE = (96, 64)
CODEC = state_codec("veryfast")
FRAMES, PAGES, TICKS = 5, 3, 1000


@pytest.fixture(scope="module")
def pictures():
    rng = np.random.default_rng(1)
    still = rng.integers(60, 190, (PAGES * SIZE[1], SIZE[0]))
    return [(still + 3 * t).astype(np.uint8) for t in range(FRAMES)]


@pytest.fixture(scope="module")
def coded(pictures):
    return encode_gop(ClosedGop(pictures, 7000, TICKS), SIZE, Fraction(24), CODEC)


def test_pages_come_back_one_below_another(coded, pictures):
    assert coded.pages == PAGES
    decoded = list(coded.pictures("x"))
    assert len(decoded) == FRAMES
    for shown, picture in zip(decoded, pictures, strict=True):
        assert np.abs(shown.astype(int) - picture).max() <= 4 * qp_step(STATE_QP)
    difference = check_gop(coded, ClosedGop(pictures, 7000, TICKS), CODEC).difference
    assert difference.shape == pictures[0].shape


def test_one_decoder_gives_page_after_page(coded, pictures):
    """It is reset by every IDR, and nothing of one page is held back behind the next."""
    samples = read_samples(coded.fragment)
    decoder = av.CodecContext.create("h264", "r")
    frames = [f for packet in [*map(av.Packet, map(start_codes, samples)), None] for f in decoder.decode(packet)]
    lumas = [frame.to_ndarray()[: SIZE[1], : SIZE[0]] for frame in frames]
    whole = list(coded.pictures("x"))
    for number, luma in enumerate(lumas):
        page, frame = divmod(number, FRAMES)
        np.testing.assert_array_equal(luma, whole[frame][page * SIZE[1] :][: SIZE[1]])
    assert len(lumas) == FRAMES * PAGES


def test_the_bytes_of_a_frame_are_those_of_all_its_pages(coded):
    samples = read_samples(coded.fragment)
    assert len(coded.picture_bytes) == FRAMES and min(coded.picture_bytes) > 0
    assert 0.9 * sum(map(len, samples)) < sum(coded.picture_bytes) <= sum(map(len, samples))


def test_the_pages_of_a_segment_last_as_long_as_its_frames(coded):
    """A tick that does not share out among pages is not lost."""
    moof = dict(read_boxes(coded.fragment))[b"moof"]
    run = moof[moof.index(b"trun") + 4 :]
    flags, count = struct.unpack_from(">II", run)
    durations = [
        struct.unpack_from(">I", run, 16 + place * 4 * (flags >> 8 & 15).bit_count())[0] for place in range(count)
    ]
    assert flags & 0x100 and count == FRAMES * PAGES
    assert sum(durations) == FRAMES * TICKS and set(durations) == {333, 334}


@pytest.mark.parametrize("samples", [slice(0, -1), slice(0, 0), slice(0, FRAMES)])
def test_pages_that_differ_in_number_are_refused(coded, samples):
    with pytest.raises(FormatError) as caught:
        list(Pictures(read_samples(coded.fragment)[samples], "x", PAGES))
        raise FormatError("bad_picture", "x", "no picture")
    assert caught.value.reason == "bad_picture"


def test_slopes_stand_in_front_page_after_page_and_all_samples_share_the_time(coded, pictures):
    slopes = encode_gop(ClosedGop([255 - pictures[0]], 0, 1), SIZE, Fraction(24), CODEC)
    slopes = replace(slopes, checksums=check_gop(slopes, ClosedGop([255 - pictures[0]], 0, 1), CODEC).checksums)
    lined = encode_gop(ClosedGop(pictures, 7000, TICKS, slopes), SIZE, Fraction(24), CODEC)
    for shown, plain in zip(lined.pictures("x"), coded.pictures("x"), strict=True):
        np.testing.assert_array_equal(shown, plain)
    assert lined.picture_bytes == [coded.picture_bytes[0] + slopes.picture_bytes[0], *coded.picture_bytes[1:]]
    checked = replace(lined, checksums=check_gop(lined, ClosedGop(pictures, 7000, TICKS, slopes), CODEC).checksums)
    first, others = open_segment(checked.media(b""), "x", PAGES)[1].cut()
    np.testing.assert_array_equal(next(iter(first)), next(iter(slopes.pictures("x"))))
    assert len(list(others)) == FRAMES
    data = io.BytesIO(init_segment(24_000, *SIZE) + checked.media(b""))
    with av.open(data, "r", format="mp4") as container:
        times = sorted(packet.pts for packet in container.demux(video=0) if packet.size)
    lasts = FRAMES * TICKS // ((FRAMES + 1) * PAGES)
    assert read_start(lined.fragment) == 7000 and len(times) == (FRAMES + 1) * PAGES
    assert set(np.diff(times).tolist()) == {lasts}  # libavformat delays all of them alike
