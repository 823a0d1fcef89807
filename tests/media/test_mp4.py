"""MP4: boxes are found by walking their tree, and what is cut or swapped is refused."""

import struct
from fractions import Fraction

import numpy as np
import pytest

from airgs_codec.errors import CodecError
from airgs_codec.media.h264 import ClosedGop, CodecSettings, encode_stream
from airgs_codec.media.mp4 import avc_configuration, codecs_string, read_boxes, read_samples


@pytest.fixture(scope="module")
def stream():
    pictures = [np.full((64, 64), level, np.uint8) for level in (90, 100, 110)]
    codec = CodecSettings(20, 1.2, 1.3, "ultrafast")
    return encode_stream([ClosedGop(pictures, 0, 1), ClosedGop(pictures[:1], 3, 1)], (64, 64), Fraction(24), 24, codec)


def box(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I4s", 8 + len(content), kind) + content


def test_the_decoder_configuration_is_found_by_the_tree_not_by_its_name(stream):
    """Bytes that read avcC may stand anywhere: in a free box, in a name."""
    record = avc_configuration(stream.init)
    assert record[0] == 1 and codecs_string(stream.init) == f"avc1.{record[1:4].hex().upper()}" == stream.codecs
    decoy = box(b"free", box(b"avcC", bytes(20)))
    assert avc_configuration(decoy + stream.init) == record


@pytest.mark.parametrize("kind", [b"moov", b"trak", b"mdia", b"minf", b"stbl", b"stsd", b"avc1", b"avcC"])
def test_an_init_segment_that_lacks_a_box_is_refused(stream, kind):
    with pytest.raises(CodecError, match=kind.decode()):
        avc_configuration(stream.init.replace(kind, b"skip"))


def test_samples_fill_the_segment(stream):
    for media, sizes in zip(stream.media, stream.picture_bytes, strict=True):
        samples = list(read_samples(media))
        assert sorted(map(len, samples)) == sorted(sizes)
        assert b"".join(samples) == dict(read_boxes(media))[b"mdat"][8:]


def test_any_cut_of_a_segment_is_refused(stream):
    for end in range(len(stream.media[0])):
        with pytest.raises(CodecError):
            list(read_samples(stream.media[0][:end]))
    for end in range(len(stream.init)):
        try:
            avc_configuration(stream.init[:end])
        except CodecError:
            continue
        pytest.fail(f"an init segment of {end} bytes was accepted")


@pytest.mark.parametrize("field", [b"traf", b"tfhd", b"trun"])
def test_a_segment_without_its_track_fragment_is_refused(stream, field):
    with pytest.raises(CodecError, match=field.decode()):
        list(read_samples(stream.media[0].replace(field, b"skip")))


@pytest.mark.parametrize("data", [b"\0\0\0\4abcd", b"\0\0\0\xffabcd", b"\0\0\0"])
def test_a_box_whose_size_leaves_the_data_is_refused(data):
    with pytest.raises(CodecError):
        read_boxes(data)
