"""MP4: boxes are found by walking their tree, and what is cut or swapped is refused."""

from fractions import Fraction

import av
import numpy as np
import pytest

from airgs_codec.media.h264 import ClosedGop, CodecSettings, encode_gop
from airgs_codec.media.mp4 import (
    OWN,
    box,
    init_segment,
    read_boxes,
    read_samples,
    read_segment,
    start_codes,
    with_own_box,
)
from tests.faces import CodecError


@pytest.fixture(scope="module")
def gops():
    pictures = [np.full((64, 64), level, np.uint8) for level in (90, 100, 110)]
    codec = CodecSettings(20, 1.3, "ultrafast")
    closed = (ClosedGop(pictures, 0, 1), ClosedGop(pictures[:1], 3, 1))
    return [encode_gop(gop, (64, 64), Fraction(24), codec) for gop in closed]


def test_samples_fill_the_segment(gops):
    for gop in gops:
        samples = read_samples(gop.fragment)
        assert b"".join(samples) == dict(read_boxes(gop.fragment))[b"mdat"][8:]
        assert 0 < sum(map(len, samples)) - sum(gop.picture_bytes) < 100  # the parameter sets


def test_checksums_and_columns_stand_in_front_of_a_segment(gops):
    fragment = gops[0].fragment
    whole = read_segment(with_own_box(fragment, (1, 2**32 - 1, 3), b"columns"))
    assert (whole.checksums, whole.columns) == ((1, 2**32 - 1, 3), b"columns")
    assert whole.samples == read_samples(fragment)
    with pytest.raises(CodecError, match="uuid"):
        read_segment(box(b"uuid", bytes(20)) + fragment)
    with pytest.raises(CodecError, match="uuid"):
        read_segment(fragment)
    with pytest.raises(CodecError, match="expected 12 at 16"):
        read_segment(box(b"uuid", OWN, bytes(11)) + fragment)
    with pytest.raises(CodecError, match="moof"):
        read_segment(with_own_box(fragment + box(b"uuid", bytes(20)), (1, 2, 3), b""))


def test_any_cut_of_a_segment_is_refused(gops):
    media = with_own_box(gops[0].fragment, (1, 2, 3), b"columns")
    for end in range(len(media)):
        with pytest.raises(CodecError):
            read_segment(media[:end])


@pytest.mark.parametrize("field", [b"traf", b"tfhd", b"trun"])
def test_a_segment_without_its_track_fragment_is_refused(gops, field):
    with pytest.raises(CodecError, match=field.decode()):
        read_samples(gops[0].fragment.replace(field, b"skip"))


def test_units_of_a_sample_are_told_apart_by_start_codes():
    assert start_codes(b"\0\0\0\2ab\0\0\0\1c") == b"\0\0\0\1ab\0\0\0\1c"
    for cut in (b"\0\0\0\2a", b"\0\0\0\0", b"\0\0"):
        with pytest.raises(CodecError):
            start_codes(cut)


def test_another_reader_finds_the_same_pictures(gops, tmp_path):
    """ffmpeg, behind the init segment that is shared by all: times, sizes and the pictures themselves."""
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


@pytest.mark.parametrize("data", [b"\0\0\0\4abcd", b"\0\0\0\xffabcd", b"\0\0\0"])
def test_a_box_whose_size_leaves_the_data_is_refused(data):
    with pytest.raises(CodecError):
        read_boxes(data)
