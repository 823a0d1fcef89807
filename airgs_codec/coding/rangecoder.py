"""Adaptive binary range coder for columns of whole numbers: exact, in few bytes (FORMAT.md §7, normative). M numbers.

A number is sent as its bit length (six binary decisions, a tree) and then the bits below its leading one: the upper
three each by a model, the others as they are. A model learns how often its decision is 1. The models of a number are
those of its column (order 0) or of the number before it (order 1). The arithmetic (32-bit range, carries delayed,
normalised by bytes) is that of LZMA's range coder (Pavlov; after Martin 1979).

The loops run as they stand, at about 4 microseconds a number, or compiled by numba where it is installed, thirty times
as fast. Loading numba takes as long as LOADING numbers do, so that many come before it is loaded. Bytes and numbers are
the same. No library replaces them: models of constriction 0.5 do not adapt, and browsers need these loops all the same.
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import FormatError

LARGEST_NUMBER = (1 << 63) - 1

RANGE_START = 0xFFFFFFFF
RANGE_LEAST = 1 << 24  # the range stays at or above it
CHANCE_HALF = 1 << 15  # probabilities are in 1 / 65536
CHANCE_LEAST = 16  # of a 1 and of a 0, in 1 / 32768
MODEL_MEMORY = 60  # decisions that a model remembers
MODEL_CONTEXTS = 16  # numbers from 15 up choose the same model
LENGTH_BITS = 6  # decisions that give a bit length
MODELLED_BITS = 3  # below the leading one: those that have models
END_BYTES = 5  # at the end, and at the start of decoding
LOADING = 1 << 18  # numbers
_CHANCE_MOST = CHANCE_HALF - CHANCE_LEAST
_LENGTHS = 1 << LENGTH_BITS  # nodes of the tree of bit lengths
_NODES = _LENGTHS + (_LENGTHS << MODELLED_BITS)
_FIRST, _LAST = 3, 2 * MODEL_MEMORY + 3  # what a model divides its error by: at first, and from MODEL_MEMORY decisions
# Dividing by d is multiplying by the d-th of these and dropping _SHARE_BITS bits: exact below 2^(_SHARE_BITS - 7).
_SHARE_BITS = 32
_SHARES = [0, *((1 << _SHARE_BITS) // divisor + 1 for divisor in range(1, _LAST + 1))]
_CODE, _RANGE, _AT, _CACHE, _PENDING, _CONTEXT = range(6)  # places in the state of the encoder
_END = 3  # in that of the decoder, after the same first three: bytes of the file
_BATCH = 1 << 14  # numbers coded into one buffer
_MOST_BYTES = 40  # of a number: 9 modelled decisions of at most 11 bits, 60 plain ones, and delayed bytes

Whole = Any  # a list of int, or (M,) int64 where the loop is compiled
Loop = Callable[..., Any]


def _encode(values: Whole, chances: Whole, divisors: Whole, shares: Whole, state: Whole, out: Any) -> None:
    """Write the bytes of `values` to `out` after state[_AT].

    `chances`, `divisors`: of each model the chance of a 1 in 1/65536, and what its error is divided by, which `shares`
    do.
    """
    low, span, at, cache, pending, context = state
    contexts = len(chances) // _NODES
    for value in values:
        length = 0
        while value >> length:
            length += 1
        place, node = context * _NODES, 1
        for i in range(LENGTH_BITS + max(0, length - 1)):
            if i == LENGTH_BITS:
                place, node = place + _LENGTHS + (length << MODELLED_BITS), 1
            bit = (length >> (LENGTH_BITS - 1 - i) if i < LENGTH_BITS else value >> (length + LENGTH_BITS - 2 - i)) & 1
            part = span >> 1
            if i < LENGTH_BITS + MODELLED_BITS:
                model = place + node
                chance, divisor = chances[model], divisors[model]
                part = (span >> 15) * min(max(chance >> 1, CHANCE_LEAST), _CHANCE_MOST)
                if bit:
                    chances[model] = chance + (2 * (65535 - chance) * shares[divisor] >> _SHARE_BITS)
                else:
                    chances[model] = chance - ((2 * chance + divisor - 1) * shares[divisor] >> _SHARE_BITS)
                divisors[model] = min(divisor + 2, _LAST)
                node = 2 * node + bit
            low, span = (low, part) if bit else (low + part, span - part)
            while span < RANGE_LEAST:
                span <<= 8
                if low < 0xFF000000 or low > RANGE_START:  # else a carry may still change the delayed bytes
                    byte, carry = cache + (low >> 32), low >> 32
                    while pending:
                        out[at] = byte & 255
                        at, byte, pending = at + 1, 255 + carry, pending - 1
                    cache = (low >> 24) & 255
                pending += 1
                low = (low & 0x00FFFFFF) << 8
        context = min(value, MODEL_CONTEXTS - 1) % contexts
    state[_CODE], state[_RANGE], state[_AT], state[_CACHE], state[_PENDING] = low, span, at, cache, pending
    state[_CONTEXT] = context


def _decode(values: Whole, chances: Whole, divisors: Whole, shares: Whole, state: Whole, data: Any) -> None:
    """Fill `values` from `data`, whose state[_END] bytes are followed by zeros; stop once the end was passed."""
    code, span, at, context = state[_CODE], state[_RANGE], state[_AT], 0
    contexts = len(chances) // _NODES
    for k in range(len(values)):
        place, node, left, length = context * _NODES, 1, LENGTH_BITS, -1
        while left:
            model = place + node
            chance, divisor = chances[model], divisors[model]
            half = chance >> 1
            if half < CHANCE_LEAST:
                half = CHANCE_LEAST
            elif half > _CHANCE_MOST:
                half = _CHANCE_MOST
            part = (span >> 15) * half
            if code < part:
                span = part
                chances[model] = chance + (2 * (65535 - chance) * shares[divisor] >> _SHARE_BITS)
                node = 2 * node + 1
            else:
                code, span = code - part, span - part
                chances[model] = chance - ((2 * chance + divisor - 1) * shares[divisor] >> _SHARE_BITS)
                node *= 2
            if divisor < _LAST:
                divisors[model] = divisor + 2
            while span < RANGE_LEAST:
                code, span, at = code << 8 | data[at], span << 8, at + 1
            left -= 1
            if left == 0 and length < 0:
                length = node - _LENGTHS
                place, node = place + _LENGTHS + (length << MODELLED_BITS), 1
                left = MODELLED_BITS if length > MODELLED_BITS else max(0, length - 1)
        value = node if length else 0
        for _ in range(length - 1 - MODELLED_BITS):
            part = span >> 1
            if code < part:
                span, value = part, 2 * value + 1
            else:
                code, span, value = code - part, span - part, 2 * value
            while span < RANGE_LEAST:
                code, span, at = code << 8 | data[at], span << 8, at + 1
        if at > state[_END]:
            break
        values[k] = value
        if contexts > 1:
            context = value if value < MODEL_CONTEXTS else MODEL_CONTEXTS - 1
    state[_CODE], state[_RANGE], state[_AT] = code, span, at


def _sum_gaps(gaps: Whole, low: Whole, bits: int, codes: Whole) -> bool:
    code = 0
    for i in range(len(gaps)):
        high = code >> low[i]
        if gaps[i] > (LARGEST_NUMBER >> (63 - bits + low[i])) - high:
            return False
        code = (high + gaps[i]) << low[i]
        codes[i] = code
    return True


Column = tuple[NDArray[np.integer], int]  # numbers (M,); order 0, or 1: the number before chooses the models


@functools.cache
def _compiled(loop: Loop) -> Loop | None:
    """Return what numba makes of a loop; None where it is not installed."""
    try:
        from numba import njit
    except ImportError:
        return None
    return njit(cache=True, nogil=True)(loop)


_numbers = 0  # that have come so far


def worth_compiling(loop: Loop, numbers: int) -> Loop | None:
    """Return what numba makes of a loop, for `numbers` more numbers; None where the loop should run as it stands."""
    global _numbers
    _numbers += numbers
    return _compiled(loop) if _numbers > LOADING or "numba" in sys.modules else None


def _models(order: int, compiled: Loop | None) -> tuple[Whole, Whole, Whole]:
    """Return `chances` and `divisors` of fresh models, one for each context and node, and `shares`."""
    count = MODEL_CONTEXTS**order * _NODES
    fresh = [np.full(count, start, np.int64) if compiled else [start] * count for start in (CHANCE_HALF, _FIRST)]
    return fresh[0], fresh[1], _mutable(_SHARES, compiled)


def encode_columns(columns: Sequence[Column]) -> bytes:
    """Return the bytes of columns, which `ColumnReader` reads. Raises ValueError for a number below 0."""
    compiled = worth_compiling(_encode, sum(len(numbers) for numbers, _ in columns))
    state, out = _mutable([0, RANGE_START, 0, 0, 1, 0], compiled), bytearray(_MOST_BYTES * _BATCH)
    buffer = np.frombuffer(out, np.uint8) if compiled else out
    parts = []
    for numbers, order in columns:
        values = np.ascontiguousarray(numbers, np.int64)
        if len(values) and int(values.min()) < 0:
            raise ValueError(f"expected numbers from 0, got {values.min()}")
        chances, divisors, shares = _models(order, compiled)
        state[_CONTEXT] = 0
        for start in range(0, len(values), _BATCH):
            some = values[start : start + _BATCH] if compiled else values[start : start + _BATCH].tolist()
            (compiled or _encode)(some, chances, divisors, shares, state, buffer)
            parts.append(bytes(out[: state[_AT]]))
            state[_AT] = 0
    low, _, _, cache, pending, _ = map(int, state)  # the delayed bytes, to which a carry may still be added
    last = (int.from_bytes(bytes([cache]) + b"\xff" * (pending - 1), "big") << 32) + low
    return b"".join([*parts, last.to_bytes(pending + 4, "big")])


def _mutable(numbers: list[int], compiled: Loop | None) -> Any:
    return np.array(numbers, np.int64) if compiled else numbers


def encode_some(columns: Sequence[Column]) -> bytes:
    """Return the same, but no bytes where every number is 0, which `ColumnReader` reads of no data."""
    return encode_columns(columns) if any(np.any(numbers) for numbers, _ in columns) else b""


class ColumnReader:
    """Decodes columns in the order in which they were encoded; `where` names the file in errors.

    Without data (None) every number is 0.
    Everything raises FormatError(bad_sidecar) when the data is not what `encode_columns` writes.
    """

    def __init__(self, data: bytes | None, where: str) -> None:
        self._absent, self.where = data is None, where
        data = bytes(END_BYTES) if data is None else data
        self._end = len(data)
        self._data = data + bytes(_MOST_BYTES)  # a number may pass the end before that is seen
        self.expect(len(data) >= END_BYTES, f"expected at least {END_BYTES} bytes, got {len(data)}")
        self.expect(not data[0], f"expected a first byte of 0, got {data[0]}")
        self._state = [int.from_bytes(data[1:END_BYTES], "big"), RANGE_START, END_BYTES, len(data)]

    def expect(self, fits: bool | np.bool_, words: str) -> None:
        """Raise FormatError(bad_sidecar) in the words that are given unless something fits."""
        if not fits:
            raise FormatError("bad_sidecar", self.where, words)

    def column(self, count: int, order: int) -> NDArray[np.int64]:
        if self._absent:
            return np.zeros(count, np.int64)
        compiled = worth_compiling(_decode, count)
        values: Whole = np.zeros(count, np.int64) if compiled else [0] * count
        chances, divisors, shares = _models(order, compiled)
        state = _mutable(self._state, compiled)
        data = np.frombuffer(self._data, np.uint8) if compiled else self._data
        (compiled or _decode)(values, chances, divisors, shares, state, data)
        self._state = list(map(int, state))
        self.expect(self._state[_AT] <= self._end, f"expected {count} more numbers, got the end of the file")
        return np.asarray(values, np.int64)

    def close(self) -> None:
        """Refuse data that is not used up exactly."""
        code, _, read, _ = self._state
        self.expect(read == self._end and not code, f"expected the end at {read}, got {self._end} bytes")


def sum_gaps(gaps: NDArray[np.int64], low: NDArray[np.int64], bits: int) -> NDArray[np.uint64] | None:
    """Return (M,) Morton codes from gaps between neighbours without their `low` bits (FORMAT.md §3).

    None when a code does not fit `bits`.
    """
    compiled = worth_compiling(_sum_gaps, 0)
    codes = _mutable([0] * len(gaps), compiled)
    steps, lows = (gaps, low) if compiled else (gaps.tolist(), low.tolist())
    fits = (compiled or _sum_gaps)(steps, lows, bits, codes)
    return np.array(codes, np.uint64) if fits else None
