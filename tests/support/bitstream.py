"""What FFmpeg reads in the headers of H.264."""

import io

import av
import av.bitstream
import av.logging


def trace_headers(mp4: bytes) -> dict[str, int]:
    """Syntax elements of the parameter sets and slice headers of the first picture of an MP4 file, by name."""
    level = av.logging.get_level()
    av.logging.set_level(av.logging.INFO)
    try:
        with av.open(io.BytesIO(mp4), "r") as container, av.logging.Capture(local=True) as lines:
            stream = container.streams.video[0]
            trace = av.bitstream.BitStreamFilterContext("trace_headers", stream)
            trace.filter(next(container.demux(stream)))
    finally:
        av.logging.set_level(level)
    fields = [text.split() for _, name, text in lines if name == "trace_headers" and " = " in text]
    return {words[1]: int(words[-1]) for words in fields}
