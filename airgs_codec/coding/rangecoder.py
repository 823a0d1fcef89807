"""Adaptive binary range coder for columns of whole numbers: exact, in few bytes (FORMAT.md §7, normative). M numbers.

A number is sent as its bit length (six binary decisions, a tree) and then the bits below its leading one: the upper
three each by a model, the others as they are. A model learns how often its decision is 1. The models of a number are
those of its column (order 0) or of the number before it (order 1). The arithmetic (32-bit range, carries kept back,
normalised by bytes) is that of LZMA's range coder (Pavlov; after Martin 1979).
"""

from __future__ import annotations

from collections.abc import Sequence

import numba
import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import FormatError

MOST = (1 << 63) - 1  # largest number

RANGE_START = 0xFFFFFFFF
RANGE_LEAST = 1 << 24  # the range is kept at or above it
CHANCE_HALF = 1 << 15  # probabilities are in 1 / 65536
CHANCE_LEAST = 16  # of a 1 and of a 0, in 1 / 32768
MODEL_MEMORY = 60  # decisions that a model remembers
MODEL_CONTEXTS = 16  # numbers from 15 up choose the same model
LENGTH_BITS = 6  # decisions that give a bit length
MODELLED_BITS = 3  # below the leading one: those that have models
END_BYTES = 5  # at the end, and at the start of decoding
_LENGTHS = 1 << LENGTH_BITS  # nodes of the tree of bit lengths
_NODES = _LENGTHS + (_LENGTHS << MODELLED_BITS)
_CODE, _RANGE, _AT, _CACHE, _PENDING, _CONTEXT = range(6)  # places in the array that is the state of the coder
_BATCH = 1 << 14  # numbers coded into one buffer
_MOST_BYTES = 40  # of a number: 9 modelled decisions of at most 11 bits, 60 plain ones, and bytes kept back


@numba.njit(cache=True)
def _shift(state: NDArray[np.int64], out: NDArray[np.uint8]) -> None:
    """Send the highest byte of `low`, or keep it back while a carry may still change it."""
    low = state[_CODE]
    if low < 0xFF000000 or low > 0xFFFFFFFF:
        carry = low >> 32
        byte = state[_CACHE] + carry
        while state[_PENDING] > 0:
            out[state[_AT]] = byte & 255
            state[_AT] += 1
            byte = 255 + carry
            state[_PENDING] -= 1
        state[_CACHE] = (low >> 24) & 255
    state[_PENDING] += 1
    state[_CODE] = (low & 0x00FFFFFF) << 8


@numba.njit(cache=True)
def _update(models: NDArray[np.int32], node: int, bit: int) -> None:
    """Move the chance of a 1 towards the decision: by one over the decisions seen so far, at least 1/MODEL_MEMORY."""
    seen = models[node, 1]
    error = (65535 if bit else 0) - models[node, 0]
    models[node, 0] += 2 * error // (2 * seen + 3)
    models[node, 1] = min(seen + 1, MODEL_MEMORY)


@numba.njit(cache=True)
def _split(models: NDArray[np.int32], node: int, range_: int) -> int:
    """The part of the range that stands for 1; never empty, never all."""
    return (range_ >> 15) * min(max(models[node, 0] >> 1, CHANCE_LEAST), CHANCE_HALF - CHANCE_LEAST)


@numba.njit(cache=True)
def _put(bit: int, part: int, state: NDArray[np.int64], out: NDArray[np.uint8]) -> None:
    if bit:
        state[_RANGE] = part
    else:
        state[_CODE] += part
        state[_RANGE] -= part
    while state[_RANGE] < RANGE_LEAST:
        state[_RANGE] <<= 8
        _shift(state, out)


@numba.njit(cache=True)
def _encode(
    values: NDArray[np.int64], models: NDArray[np.int32], state: NDArray[np.int64], out: NDArray[np.uint8]
) -> None:
    for value in values:
        base = state[_CONTEXT] * _NODES
        length = 0
        while value >> length:
            length += 1
        node = 1
        for i in range(LENGTH_BITS - 1, -1, -1):
            bit = (length >> i) & 1
            _put(bit, _split(models, base + node, state[_RANGE]), state, out)
            _update(models, base + node, bit)
            node = 2 * node + bit
        node = 1
        for i in range(length - 2, -1, -1):
            bit = (value >> i) & 1
            if length - 2 - i < MODELLED_BITS:
                at = base + _LENGTHS + (length << MODELLED_BITS) + node
                _put(bit, _split(models, at, state[_RANGE]), state, out)
                _update(models, at, bit)
                node = 2 * node + bit
            else:
                _put(bit, state[_RANGE] >> 1, state, out)
        state[_CONTEXT] = min(int(value), MODEL_CONTEXTS - 1) % (len(models) // _NODES)


@numba.njit(cache=True)
def _take(part: int, state: NDArray[np.int64], data: NDArray[np.uint8]) -> int:
    bit = 1 if state[_CODE] < part else 0
    if bit:
        state[_RANGE] = part
    else:
        state[_CODE] -= part
        state[_RANGE] -= part
    while state[_RANGE] < RANGE_LEAST:
        state[_RANGE] <<= 8
        byte = data[state[_AT]] if state[_AT] < len(data) else 0
        state[_AT] += 1
        state[_CODE] = (state[_CODE] << 8) | byte
    return bit


@numba.njit(cache=True, nogil=True)
def _decode(
    values: NDArray[np.int64], models: NDArray[np.int32], state: NDArray[np.int64], data: NDArray[np.uint8]
) -> None:
    """Fill `values`; stop once the end of the data was passed."""
    for k in range(len(values)):
        base = state[_CONTEXT] * _NODES
        node = 1
        for _ in range(LENGTH_BITS):
            bit = _take(_split(models, base + node, state[_RANGE]), state, data)
            _update(models, base + node, bit)
            node = 2 * node + bit
        length = node - _LENGTHS
        value = np.int64(1 if length else 0)
        node = 1
        for i in range(length - 1):
            if i < MODELLED_BITS:
                at = base + _LENGTHS + (length << MODELLED_BITS) + node
                bit = _take(_split(models, at, state[_RANGE]), state, data)
                _update(models, at, bit)
                node = 2 * node + bit
            else:
                bit = _take(state[_RANGE] >> 1, state, data)
            value = 2 * value + bit
        if state[_AT] > len(data):
            return
        values[k] = value
        state[_CONTEXT] = min(int(value), MODEL_CONTEXTS - 1) % (len(models) // _NODES)


Column = tuple[NDArray[np.integer], int]  # numbers (M,) in 0..MOST; order 0, or 1: the number before chooses the models


def _models(order: int) -> NDArray[np.int32]:
    """A fresh model for each context and node, (contexts * nodes, 2): the chance of a 1 in 1/65536, decisions seen."""
    models = np.zeros((MODEL_CONTEXTS**order * _NODES, 2), np.int32)
    models[:, 0] = CHANCE_HALF
    return models


def encode_columns(columns: Sequence[Column]) -> bytes:
    """Columns -> bytes, which `ColumnReader` gives back. Raises ValueError for a number below 0."""
    state = np.array([0, RANGE_START, 0, 0, 1, 0], np.int64)
    out = np.empty(_MOST_BYTES * _BATCH, np.uint8)
    parts = []
    for numbers, order in columns:
        values = np.ascontiguousarray(numbers, np.int64)
        if len(values) and int(values.min()) < 0:
            raise ValueError(f"expected numbers from 0, got {values.min()}")
        models = _models(order)
        state[_CONTEXT] = 0
        for start in range(0, len(values), _BATCH):
            _encode(values[start : start + _BATCH], models, state, out)
            parts.append(out[: state[_AT]].tobytes())
            state[_AT] = 0
    for _ in range(END_BYTES):
        _shift(state, out)
    return b"".join([*parts, out[: state[_AT]].tobytes()])


def encode_some(columns: Sequence[Column]) -> bytes:
    """As `encode_columns`, but no bytes where every number is 0, which `ColumnReader` reads of no data."""
    return encode_columns(columns) if any(np.any(numbers) for numbers, _ in columns) else b""


class ColumnReader:
    """Decodes columns in the order in which they were encoded; `where` names the file in errors.

    Without data (None) every number is 0.
    Everything raises FormatError(bad_sidecar) when the data is not what `encode_columns` writes.
    """

    def __init__(self, data: bytes | None, where: str) -> None:
        self._absent = data is None
        data = bytes(END_BYTES) if data is None else data
        self._data = np.frombuffer(data, np.uint8)
        self.where = where
        if len(data) < END_BYTES:
            raise FormatError("bad_sidecar", where, f"expected at least {END_BYTES} bytes, got {len(data)}")
        self._state = np.array([int.from_bytes(data[1:END_BYTES], "big"), RANGE_START, END_BYTES, 0, 0, 0], np.int64)
        if data[0]:
            raise FormatError("bad_sidecar", where, f"expected a first byte of 0, got {data[0]}")

    def column(self, count: int, order: int) -> NDArray[np.int64]:
        """The next column, (count,) numbers of this order."""
        values = np.zeros(count, np.int64)
        if self._absent:
            return values
        self._state[_CONTEXT] = 0
        _decode(values, _models(order), self._state, self._data)
        if self._state[_AT] > len(self._data):
            raise FormatError("bad_sidecar", self.where, f"expected {count} more numbers, got the end of the file")
        return values

    def close(self) -> None:
        """Refuse data that is not used up exactly."""
        if self._state[_AT] != len(self._data) or self._state[_CODE]:
            read = int(self._state[_AT])
            raise FormatError("bad_sidecar", self.where, f"expected the end at {read}, got {len(self._data)} bytes")


@numba.njit(cache=True)
def sum_gaps(gaps: NDArray[np.int64], low: NDArray[np.int64], bits: int, codes: NDArray[np.uint64]) -> bool:
    """Fill (M,) Morton codes from gaps between neighbours without their `low` bits (FORMAT.md §3).

    False when a code does not fit `bits`.
    """
    code = 0
    for i in range(len(gaps)):
        high = code >> low[i]
        if gaps[i] > (MOST >> (63 - bits + low[i])) - high:
            return False
        code = (high + gaps[i]) << low[i]
        codes[i] = code
    return True
