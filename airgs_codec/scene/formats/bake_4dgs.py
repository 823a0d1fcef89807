"""A program of its own that bakes a .4dgs file to frames with fourdgs; it imports nothing of this package.

`python bake_4dgs.py FILE TARGET FPS FIRST STOP` writes TARGET, an .npz: `counts` (F,) rows of all frames, `breaks`
frames whose rows are others than those of the frame before, `fps`, `degree` and `model`, `up` and `metres`, the
direction (3,) that points up and the length of a unit (empty and 0 where the file does not tell), and of frames
[FIRST, STOP) the rows one frame after the other. FPS 0 stands for what the file says. `limited` runs it.

Frame i is the scene at (i + 1/2) / fps seconds, in the middle of its time: what lasts for one frame is whole there.
Gaussians of the model `keyframe-delta` have numbers: they are in the order of these. Those of `gaussian-birth` move
evenly and appear and fade within windows of time: frames with the same windows have the same rows, in the order of
the file; of a row that is not there at some time, alpha is 0 and it stays where it was last. N rows.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from fourdgs import opcode, records, stream_reader
from fourdgs.keyframe_delta_file import DecodedSequence, reconstruct_at, scan_streamed
from fourdgs.quantization import SH_QUANT_HI, SH_QUANT_LO, support_k
from fourdgs.registry import check_quantization_scheme, check_temporal_model
from fourdgs.serialization import MAGIC, Cursor, check_magic, decode_stream, iter_records

DEFAULT_FPS = 30
FEWEST_FPS = 10  # pieces of equal length are frames if there are so many a second
SAME_TIME = 1e-4  # seconds
MOST_FRAMES = 1 << 18
DELTA, BIRTH = "keyframe-delta", "gaussian-birth"
METRES = {1: 1.0, 2: 0.01, 3: 0.001, 4: 1000.0, 5: 0.3048, 6: 0.0254}  # of the units that have a name
Frame = dict[str, np.ndarray]  # ids (N,), means (N, 3), quaternions (N, 4) w x y z, scales, alpha, rgb, sh (N, K, 3)


class File:
    """The records of a file; chunks are not decoded."""

    def __init__(self, data: bytes) -> None:
        check_magic(data)
        self.up, self.metres = np.zeros(0), 0.0
        self.data, self.windows, self.chunks = data, np.zeros((1, 2)), list[tuple[float, float, Any, list[Any]]]()
        for record in iter_records(data, len(MAGIC)):
            self._add(record.opcode, record.content)
        self.windows = self.windows if len(self.windows) else np.zeros((1, 2))
        if self.header.temporal_model != DELTA:
            check_temporal_model(self.header.temporal_model)
        check_quantization_scheme(self.quantization.scheme)

    def _add(self, kind: int, content: Any) -> None:
        if kind == opcode.HEADER:
            self.header = records.Header.parse(content)
        elif kind == opcode.QUANTIZATION:
            self.quantization = records.Quantization.parse(content)
        elif kind == opcode.WINDOW_TABLE:
            self.windows = np.array(records.WindowTable.parse(content).windows, np.float64).reshape(-1, 2)
        elif kind == opcode.COORDINATE_FRAME:
            self._set_axes(records.CoordinateFrame.parse(content))
        elif kind in (opcode.CHUNK, opcode.DELTA_CHUNK):
            cursor = Cursor(content)
            self.chunks.append((cursor.f64(), cursor.f64(), content, []))
        elif kind == opcode.SH_BAND_STREAM and self.chunks:
            self.chunks[-1][3].append(content)
        elif kind == opcode.OBJECT_TRACK:
            raise ValueError("object tracks are not read: bake them into the Gaussians")

    def _set_axes(self, frame: Any) -> None:
        """The frame without a name is that of the scene; section 5.15.2 of the specification."""
        if frame.name:
            return
        self.metres = frame.metres_per_unit if frame.metres_per_unit > 0 else METRES.get(frame.length_unit, 0.0)
        if frame.up_axis < 6:
            self.up = np.eye(3)[frame.up_axis % 3] * (1 if frame.up_axis < 3 else -1)

    def rate(self) -> Fraction:
        """Frames a second that the file has: its states, or all windows of its Gaussians, begin and end with frames."""
        delta = self.header.temporal_model == DELTA
        edges = np.unique(np.array([chunk[:2] for chunk in self.chunks]) if delta else self.windows)
        edges = edges[np.isfinite(edges)]
        edges = edges[np.diff(edges, prepend=-np.inf) > SAME_TIME]
        lengths = np.diff(edges)
        if len(lengths) < 2:
            return Fraction(DEFAULT_FPS)
        frames = lengths / lengths.min()
        if not np.allclose(frames, np.rint(frames), rtol=0, atol=0.02):
            return Fraction(DEFAULT_FPS)
        rate = Fraction(np.rint(frames).sum() / float(edges[-1] - edges[0])).limit_denominator(1001)
        return rate if rate >= FEWEST_FPS else Fraction(DEFAULT_FPS)


def birth_runs(file: File, times: np.ndarray) -> list[tuple[int, int, list[int]]]:
    """Frames [start, stop) with the same windows, and the chunks that are there in some of them."""
    bounds = np.unique(file.windows)
    at = np.searchsorted(bounds, times, "right")
    starts = [0, *(1 + np.flatnonzero(np.diff(at))).tolist(), len(times)]
    pieces = np.array([chunk[:2] for chunk in file.chunks]).reshape(-1, 2)
    runs = []
    for start, stop in itertools.pairwise(starts):
        there = (pieces[:, 0] <= times[stop - 1]) & (pieces[:, 1] > times[start])
        runs.append((start, stop, np.flatnonzero(there).tolist()))
    return runs


def read_births(file: File, chunks: list[int]) -> Frame:
    """The rows of some chunks, decoded."""
    steps, origin = stream_reader.steps_from(file.quantization), np.asarray(file.quantization.pos_origin)
    parts: list[Frame] = []
    bands: list[dict[int, np.ndarray]] = []
    for _, _, content, streams in (file.chunks[i] for i in chunks):
        head, body = records.parse_chunk(content)
        body = stream_reader.chunk_stream_bytes(head, body)
        parts.append(stream_reader.decode_streams(body, head.count, steps, origin, file.windows, file.header.cutoff))
        bands.append({})
        for stream in streams:
            cursor = Cursor(stream)
            number = cursor.u8()
            bands[-1][number] = decode_stream(cursor)[1]
    names = ("positions", "scales", "rotations", "colors", "motions", "mu_t", "sigma_t", "window_index")
    rows = {name: np.concatenate([part[name] for part in parts]) for name in names}
    sh = stream_reader.merge_chunk_bands([len(part["mu_t"]) for part in parts], bands)
    coded = np.zeros((len(rows["mu_t"]), 0), np.uint8) if sh is None else sh
    rows["sh"] = (SH_QUANT_LO + coded * ((SH_QUANT_HI - SH_QUANT_LO) / 255)).astype(np.float32)
    return rows


def birth_at(file: File, rows: Frame, t: float) -> Frame:
    """The state at a time in seconds; section 3 of the specification but for rows that are not there."""
    lo, hi = file.windows[rows["window_index"]].T
    sigma, mu = rows["sigma_t"], rows["mu_t"]
    with np.errstate(all="ignore"):
        fading = np.where(np.isfinite(sigma), np.exp(-0.5 * np.square((t - mu) / np.maximum(sigma, 1e-30))), 1.0)
        half = np.where(np.isfinite(sigma), support_k(file.header.cutoff) * sigma, np.inf)
    there = (lo <= t) & (t < hi) & (fading >= file.header.cutoff)
    shown = np.where(there, t, np.clip(t, np.maximum(lo, mu - half), np.maximum(lo, np.minimum(hi, mu + half))))
    return {
        "means": rows["positions"] + rows["motions"] * (shown - mu)[:, None],
        "quaternions": rows["rotations"][:, [3, 0, 1, 2]],
        "scales": rows["scales"],
        "alpha": rows["colors"][:, 3] * np.where(there, fading, 0),
        "rgb": rows["colors"][:, :3],
        "sh": rows["sh"].reshape(len(mu), 3, -1).transpose(0, 2, 1),
    }


def delta_frames(file: File, times: np.ndarray) -> Iterator[Frame]:
    """Every frame of numbered Gaussians, in the order of the numbers."""
    quantization, windows = file.quantization, [(float(a), float(b)) for a, b in file.windows]
    grids = DecodedSequence(file.header, quantization, windows).grids
    spans: list[tuple[float, float]] = []
    done = 0
    for _, _, state in scan_streamed(file.data, on_state=lambda _, t0, t1: spans.append((t0, t1))):
        while done < len(times) and times[done] < spans[-1][1]:
            r = reconstruct_at(state, grids, float(times[done]))
            yield {
                "ids": r["ids"],
                "means": r["centers"],
                "quaternions": np.asarray(r["rotations"])[:, [3, 0, 1, 2]],
                "scales": r["scales"],
                "alpha": r["opacity"],
                "rgb": r["rgb"],
                "sh": np.zeros((len(r["ids"]), 0, 3), np.float32),
            }
            done += 1
        if done == len(times):
            return
    if done < len(times):
        raise ValueError(f"states of {done} frames where the duration is that of {len(times)}")


def bake_numbered(file: File, times: np.ndarray, wanted: range) -> tuple[dict[str, Any], list[Frame]]:
    """The frames that are wanted or, where none are, what is to be known of all."""
    if wanted:
        return {}, list(delta_frames(file, times[wanted.start : wanted.stop]))
    counts, breaks, before = [], [], None
    for number, frame in enumerate(delta_frames(file, times)):
        if before is not None and not np.array_equal(before, frame["ids"]):
            breaks.append(number)
        before = frame["ids"]
        counts.append(len(before))
    return {"counts": np.array(counts, np.int64), "breaks": np.array(breaks, np.int64)}, []


def bake(file: File, fps: Fraction, wanted: range) -> tuple[dict[str, Any], list[Frame]]:
    """Return what is to be known of all frames, and those that are wanted."""
    count = round(file.header.duration_sec * fps)
    if not 0 < file.header.duration_sec * fps <= MOST_FRAMES:
        raise ValueError(f"expected 1 to {MOST_FRAMES} frames, got {file.header.duration_sec:g} s at {fps} fps")
    times = (np.arange(max(1, count)) + 0.5) / float(fps)
    if file.header.temporal_model == DELTA:
        return bake_numbered(file, times, wanted)
    counts, breaks, frames = np.zeros(len(times), np.int64), [], []
    for start, stop, chunks in birth_runs(file, times):
        counts[start:stop] = sum(records.parse_chunk(file.chunks[i][2])[0].count for i in chunks)
        breaks += [start] * (start > 0 and stop - start > 1)
        inside = range(max(start, wanted.start), min(stop, wanted.stop))
        rows = read_births(file, chunks) if inside else {}
        frames += [birth_at(file, rows, times[number]) for number in inside]
    return {"counts": counts, "breaks": np.array(breaks, np.int64)}, frames


def main(source: str, target: str, fps: str, first: str, stop: str) -> None:
    """Bake; what went wrong is the last line on standard error."""
    try:
        file = File(Path(source).read_bytes())
        rate = Fraction(fps) or file.rate()
        known, frames = bake(file, rate, range(int(first), int(stop)))
    except Exception as error:
        sys.exit(f"{type(error).__name__}: {str(error).splitlines()[0] if str(error) else ''}")
    columns = ("means", "quaternions", "scales", "alpha", "rgb", "sh") if frames else ()
    known |= {name: np.concatenate([frame[name] for frame in frames]).astype(np.float32) for name in columns}
    model = file.header.temporal_model
    degree = file.header.sh_degree if model == BIRTH and any(chunk[3] for chunk in file.chunks) else 0
    known |= {"up": file.up, "metres": np.float64(file.metres)}
    np.savez(target, fps=str(rate), degree=degree, model=model, stated=file.header.sh_degree, **known)


if __name__ == "__main__":
    main(*sys.argv[1:])
