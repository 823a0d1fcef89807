"""H.264 in MP4: closed GOPs decode alone within their QP, pages come back whole, what is cut or swapped is refused."""

import io
import random
import struct
from dataclasses import replace
from fractions import Fraction

import av
import av.bitstream
import av.logging
import numpy as np
import pytest

from airgs_codec.media import h264, mp4
from airgs_codec.media.h264 import ClosedGop, CodecSettings, Pictures, check_gop, delta_codec, keyframe_codec
from airgs_codec.media.mp4 import box, init_segment, read_boxes, read_samples, read_segment, start_codes, with_own_box
from tests.faces import CodecError, FormatError

SIZE = (96, 64)
STEP = 2 ** (16 / 6)  # of QP 20, luma levels
CODEC = delta_codec("veryfast")
FRAMES, PAGES, TICKS = 5, 3, 1000  # of pictures that are too large for one


def trace_headers(mp4):
    """Syntax elements, by name, that FFmpeg reads in the parameter sets and headers of the first picture of a file."""
    level = av.logging.get_level()
    av.logging.set_level(av.logging.INFO)
    try:
        with av.open(io.BytesIO(mp4), "r") as container, av.logging.Capture(local=True) as lines:
            stream = container.streams.video[0]
            av.bitstream.BitStreamFilterContext("trace_headers", stream).filter(next(container.demux(stream)))
    finally:
        av.logging.set_level(level)
    fields = [text.split() for _, name, text in lines if name == "trace_headers" and " = " in text]
    return {words[1]: int(words[-1]) for words in fields}


def pictures(count, seed=0, width=96, height=64):
    rng = np.random.default_rng(seed)
    still = rng.integers(60, 200, (height, width))
    return [(still + 3 * t + rng.integers(-2, 3, still.shape)).clip(0, 255).astype(np.uint8) for t in range(count)]


def encode_gop(gop, codec=CODEC, size=SIZE, rate=24):
    return h264.encode_gop(gop, size, Fraction(rate), codec)


def checked(gop, codec=CODEC):
    """A GOP that was decoded once, so that it has checksums."""
    coded = encode_gop(gop, codec)
    return replace(coded, checksums=check_gop(coded, gop, codec).checksums)


@pytest.fixture(scope="module")
def gops():
    pictures = [np.full((64, 64), level, np.uint8) for level in (90, 100, 110)]
    closed = (ClosedGop(pictures, 0, 1), ClosedGop(pictures[:1], 3, 1))
    return [encode_gop(gop, CodecSettings(20, 1.3, "ultrafast"), (64, 64)) for gop in closed]


@pytest.fixture(scope="module")
def tall():
    still = np.random.default_rng(1).integers(60, 190, (PAGES * SIZE[1], SIZE[0]))
    return ClosedGop([(still + 3 * t).astype(np.uint8) for t in range(FRAMES)], 7000, TICKS)


@pytest.fixture(scope="module")
def paged(tall):
    return encode_gop(tall)


@pytest.mark.parametrize("preset", ["ultrafast", "veryslow"])
def test_every_closed_gop_decodes_alone_and_completely(preset):
    assert h264.qp_step(20) == pytest.approx(STEP) and h264.qp_step(4) == 1
    for gop in (pictures(12), pictures(7, 1), pictures(1, 2)):
        coded = encode_gop(ClosedGop(gop, 12000, 1000), CodecSettings(20, 1.3, preset))
        decoded = list(coded.pictures("x"))
        assert len(decoded) == len(gop) == len(coded.picture_bytes)
        assert sum(coded.picture_bytes) <= len(coded.fragment)
        assert b"x264" not in coded.fragment, "no banner of the encoder"
        for a, b in zip(decoded, gop, strict=True):
            error = np.abs(a.astype(int) - b)
            assert error.max() <= 4 * STEP and error.mean() <= STEP / 2


def test_broken_bytes_and_pages_that_differ_in_number_are_refused(paged):
    whole = read_samples(encode_gop(ClosedGop(pictures(3), 0, 1), CodecSettings(20, 1.0)).fragment)
    one = [(samples, 3, 1) for samples in (whole[1:], [whole[0][:-1]], [b"\0\0\0\1\x65"])]
    parts = [read_samples(paged.fragment)[cut] for cut in (slice(0, -1), slice(0, 0), slice(0, FRAMES))]
    for samples, count, pages in (*one, *((part, FRAMES, PAGES) for part in parts)):
        with pytest.raises(FormatError) as caught:
            if len(list(Pictures(samples, "x", pages))) < count:
                raise FormatError("bad_picture", "x", "no picture")
        assert caught.value.reason == "bad_picture"
    with pytest.raises(FormatError) as caught:
        h264.open_segment(b"moof?", "x")
    assert caught.value.reason == "bad_picture"


@pytest.mark.parametrize("codec", [keyframe_codec("veryfast"), delta_codec("veryslow")])
def test_no_flipped_bit_changes_a_picture(codec):
    """FFmpeg conceals most damage, and some H.264 is as good after it: the checksums tell."""
    coded = checked(ClosedGop(pictures(6 if codec.between else 1), 0, 1), codec)
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
    right = pictures(4)
    coded = encode_gop(ClosedGop(right, 0, 1))
    check_gop(coded, ClosedGop(right, 0, 1), CODEC)
    for other in (pictures(4, 5), right[:3], [*right, right[0]], [p[:32] for p in right]):
        with pytest.raises(CodecError, match="segment at 7 ticks"):
            check_gop(coded, ClosedGop(other, 7, 1), CODEC)


@pytest.mark.parametrize(("codec", "reordered"), [(keyframe_codec("veryslow"), 0), (delta_codec("veryslow"), 2)])
def test_the_stream_says_what_a_decoder_must_hold(codec, reordered):
    """Without that in the VUI some decoders hold 16 pictures back."""
    coded = encode_gop(ClosedGop(pictures(9 if codec.between else 1), 0, 1000), codec)
    sps = trace_headers(init_segment(24000, 64, 64) + coded.fragment)
    assert sps["bitstream_restriction_flag"] == sps["video_full_range_flag"] == 1
    assert sps["max_num_reorder_frames"] == reordered
    assert reordered <= sps["max_dec_frame_buffering"] == sps["max_num_ref_frames"] <= (16 if codec.between else 1)


@pytest.mark.parametrize("codec", [keyframe_codec("ultrafast"), delta_codec("veryslow")])
@pytest.mark.parametrize(("size", "rate"), [((3072, 3072), 24), ((2048, 2048), 120)])
def test_no_level_is_higher_than_decoders_have(codec, size, rate):
    """16 reference pictures of 36,864 macroblocks would be level 6, 120 pictures of 2048x2048 a second level 5.2."""
    coded = encode_gop(ClosedGop([np.full(size[::-1], 128, np.uint8)], 0, 1000), codec, size, rate)
    sps = trace_headers(init_segment(24000, 64, 64) + coded.fragment)
    assert sps["level_idc"] <= 51
    assert sps["max_dec_frame_buffering"] * size[0] * size[1] // 256 <= 184_320


def test_samples_outside_the_limited_range_are_noticed_wherever_they_are():
    """One sample does: in one corner of one picture."""
    for corner, inside in ((128, True), (5, False), (250, False)):
        gop = [np.full((64, 96), 128, np.uint8) for _ in range(3)]
        gop[1][-8:, -8:] = corner
        closed = ClosedGop(gop, 0, 1)
        assert check_gop(encode_gop(closed), closed, CODEC).in_range == inside
    for low, high, inside in ((16, 235, True), (15, 235, False), (16, 236, False)):
        assert h264.in_range(np.array([[low, high]], np.uint8)) == inside


def test_pages_come_back_one_below_another_from_one_decoder(paged, tall):
    """It is reset by every IDR, and nothing of one page is held back behind the next."""
    whole, samples = list(paged.pictures("x")), read_samples(paged.fragment)
    assert paged.pages == PAGES and len(whole) == FRAMES
    for shown, picture in zip(whole, tall.pictures, strict=True):
        assert np.abs(shown.astype(int) - picture).max() <= 4 * STEP
    assert check_gop(paged, tall, CODEC).difference.shape == tall.pictures[0].shape
    decoder = av.CodecContext.create("h264", "r")
    frames = [f for packet in [*map(av.Packet, map(start_codes, samples)), None] for f in decoder.decode(packet)]
    assert len(frames) == FRAMES * PAGES
    for number, luma in enumerate(frame.to_ndarray()[: SIZE[1], : SIZE[0]] for frame in frames):
        page, frame = divmod(number, FRAMES)
        np.testing.assert_array_equal(luma, whole[frame][page * SIZE[1] :][: SIZE[1]])


def test_the_bytes_and_the_time_of_a_frame_are_those_of_all_its_pages(paged):
    """A tick that does not share out among pages is not lost."""
    samples = read_samples(paged.fragment)
    assert len(paged.picture_bytes) == FRAMES and min(paged.picture_bytes) > 0
    assert 0.9 * sum(map(len, samples)) < sum(paged.picture_bytes) <= sum(map(len, samples))
    moof = dict(read_boxes(paged.fragment))[b"moof"]
    run = moof[moof.index(b"trun") + 4 :]
    flags, count = struct.unpack_from(">II", run)
    stride = 4 * (flags >> 8 & 15).bit_count()
    durations = [struct.unpack_from(">I", run, 16 + place * stride)[0] for place in range(count)]
    assert flags & 0x100 and count == FRAMES * PAGES
    assert sum(durations) == FRAMES * TICKS and set(durations) == {333, 334}


def test_slopes_stand_in_front_page_after_page_and_all_samples_share_the_time(paged, tall):
    slopes = checked(ClosedGop([255 - tall.pictures[0]], 0, 1))
    lined = checked(replace(tall, slopes=slopes))
    for shown, plain in zip(lined.pictures("x"), paged.pictures("x"), strict=True):
        np.testing.assert_array_equal(shown, plain)
    assert lined.picture_bytes == [paged.picture_bytes[0] + slopes.picture_bytes[0], *paged.picture_bytes[1:]]
    first, others = h264.open_segment(lined.media(b""), "x", PAGES)[1].cut()
    np.testing.assert_array_equal(next(iter(first)), next(iter(slopes.pictures("x"))))
    assert len(list(others)) == FRAMES
    data = io.BytesIO(init_segment(24_000, *SIZE) + lined.media(b""))
    with av.open(data, "r", format="mp4") as container:
        times = sorted(packet.pts for packet in container.demux(video=0) if packet.size)
    lasts = FRAMES * TICKS // ((FRAMES + 1) * PAGES)
    assert mp4.read_start(lined.fragment) == 7000 and len(times) == (FRAMES + 1) * PAGES
    assert set(np.diff(times).tolist()) == {lasts}  # libavformat delays all of them alike


def test_checksums_and_columns_stand_in_front_of_a_segment_and_no_part_of_it_may_lack(gops):
    fragment = gops[0].fragment
    media = with_own_box(fragment, (1, 2**32 - 1, 3), b"columns")
    whole = read_segment(media)
    assert (whole.checksums, whole.columns) == ((1, 2**32 - 1, 3), b"columns")
    assert whole.samples == read_samples(fragment)
    for broken, says in (
        (box(b"uuid", bytes(20)) + fragment, "uuid"),
        (fragment, "uuid"),
        (box(b"uuid", mp4.OWN_UUID, bytes(11)) + fragment, "expected 12 at 16"),
        (with_own_box(fragment + box(b"uuid", bytes(20)), (1, 2, 3), b""), "moof"),
        *((media.replace(field, b"skip"), field.decode()) for field in (b"traf", b"trun")),
        *((media[:end], ".") for end in range(len(media))),
    ):
        with pytest.raises(CodecError, match=says):
            read_segment(broken)


def test_another_reader_finds_the_same_pictures(gops, tmp_path):
    """ffmpeg, behind the init segment that is shared by all: times, sizes and the pictures themselves."""
    for gop in gops:
        samples = read_samples(gop.fragment)
        assert b"".join(samples) == dict(read_boxes(gop.fragment))[b"mdat"][8:]
        assert 0 < sum(map(len, samples)) - sum(gop.picture_bytes) < 100  # the parameter sets
    (tmp_path / "x.mp4").write_bytes(init_segment(24, 64, 64) + b"".join(gop.fragment for gop in gops))
    with av.open(str(tmp_path / "x.mp4")) as container:
        assert container.streams.video[0].codec_context.codec_tag == "avc3"
        frames = list(container.decode(video=0))
    ours = [p for gop in gops for p in gop.pictures("x")]
    assert len(frames) == len(ours) == 4
    for frame, picture in zip(frames, ours, strict=True):
        assert (frame.width, frame.height) == (64, 64)
        luma = np.frombuffer(memoryview(frame.planes[0]), np.uint8).reshape(-1, frame.planes[0].line_size)
        assert (luma[:64, :64] == picture).all()
    assert np.diff([frame.pts for frame in frames]).tolist() == [1, 1, 1]


def test_start_codes_tell_units_apart_and_a_size_that_leaves_the_data_is_refused():
    assert start_codes(b"\0\0\0\2ab\0\0\0\1c") == b"\0\0\0\1ab\0\0\0\1c"
    boxes, units = (b"\0\0\0\4abcd", b"\0\0\0\xffabcd", b"\0\0\0"), (b"\0\0\0\2a", b"\0\0\0\0", b"\0\0")
    for read, data in (*((read_boxes, data) for data in boxes), *((start_codes, data) for data in units)):
        with pytest.raises(CodecError):
            read(data)
