"""Stored results: what is packed comes back, what was tampered with does not, and no code of a file is run."""

import json
import pickle
from dataclasses import dataclass, make_dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from tests.faces import ConfigError, EncodeSettings, Usage, content_digest, open_store, pack, seal, unpack, unseal

OURS = ("airgs_codec", "tests")


@dataclass(frozen=True)
class Pair:
    first: object
    second: object


def test_values_come_back_as_they_were():
    table = np.arange(6, dtype=np.float32).reshape(2, 3)
    value = {
        "plain": [None, True, -3, 1 << 80, 0.1, float("inf"), "ä\ud800", b"\x00bytes"],
        (1, 2): ((), (Fraction(30000, 1001),), Path("a/b")),
        3: Pair(Pair(1, [2]), EncodeSettings(quality=2.0)),
    }
    assert unpack(pack(value), OURS) == value
    assert list(unpack(pack({"b": 1, "a": 2}))) == ["b", "a"]
    arrays = [table, table.T, np.asfortranarray(table), table[::-1, ::2], np.float32(0.1), np.array(7), np.array(["a"])]
    for array, other in zip(arrays, unpack(pack(arrays)), strict=True):
        np.testing.assert_array_equal(array, other)
        assert type(array) is type(other) and array.dtype == other.dtype
        assert array.flags.f_contiguous == other.flags.f_contiguous or array is arrays[3]
    numbers = [np.float64(n) for n in range(100)]  # made and gone one after another, they may lie at one address
    assert unpack(pack(numbers)) == numbers
    assert np.isnan(unpack(pack(float("nan"))))
    usage = Usage(np.ones(3), np.full(3, np.nan), np.arange(3))
    np.testing.assert_array_equal(unpack(pack(usage)).peak, usage.peak)


def test_equal_content_has_one_name_and_any_change_another():
    table, pair = np.arange(6, dtype=np.float32).reshape(2, 3), make_dataclass("Pair", ["first", "second"])
    values = [
        1, 1.0, True, "1", b"1", None, (1,), [[1]], {"a": 1}, {"b": 1}, pair(1, 2), pair(2, 1), pair((1, 2), ()),
        table, table.T, table.reshape(3, 2), table.astype(np.float64), np.nan,
        EncodeSettings(), EncodeSettings(quality=2.0),
    ]  # fmt: skip
    names = [content_digest(value) for value in values]
    assert len(set(names)) == len(values)
    assert content_digest(table.T.copy()) == content_digest(table.T)
    assert content_digest({"a": 1, "b": 2}) == content_digest({"b": 2, "a": 1})
    assert content_digest((1, 2)) == content_digest([1, 2]) and content_digest("ab", "c") != content_digest("a", "bc")
    for value in (object(), {1, 2}, print, [object()]):  # what has no content
        with pytest.raises(TypeError):
            content_digest(value)


def packed(value):
    text = json.dumps({"value": value, "sizes": []}).encode()
    return len(text).to_bytes(8, "little") + text


MADE_UP = [
    {"is": "os:system", "of": {"command": "true"}},
    {"is": "airgs_codec.places.results:importlib.import_module", "of": {"name": "antigravity"}},
    {"is": "airgs_codec.places.results:open_store", "of": {"place": "x"}},
    {"is": "airgs_codec.places.results:Path", "of": {}},
    {"is": "airgs_codec.nothing:Here", "of": {}},
    {"is": "airgs_codecs.evil:Class", "of": {}},
    {"is": "tests.places.test_results:Pair", "of": {"first": 1, "second": 2}},
    {"is": "airgs_codec.encoder.settings:EncodeSettings", "of": {"quality_of_old": 1}},
    {"pickle": 0}, {"array": 0}, {"fraction": "1e999999999"}, {"fraction": "1/0"}, {},
]  # fmt: skip

BROKEN = [b"", b"\x00" * 8, b"\xff" * 20, pickle.dumps({"a": 1}), pack([b"abc"])[:-4]]
HEADERS = [(b"}", b"("), (b"(3,), }" + b" " * 15, b"(3" + b"0" * 15 + b",), }")]  # one is broken, one is absurd


def test_nothing_but_values_and_dataclasses_of_this_package_are_packed_or_made():
    plain = type("Plain", (), {})()  # no dataclass
    for value in (object(), {1, 2}, print, [plain], np.array([object()]), EncodeSettings, 1j):
        with pytest.raises(TypeError):
            pack(value)
    array = pack(np.zeros(3))
    torn = [*BROKEN, *(pack([data])[:4] + data for data in BROKEN)]
    for data in (*map(packed, MADE_UP), *torn, *(array.replace(old, new) for old, new in HEADERS)):
        assert data != array
        with pytest.raises(ValueError, match="expected a stored value"):
            unpack(data)


@pytest.mark.parametrize("kind", ["folder", "bucket"])
def test_an_entry_is_whole_or_absent_and_a_file_is_no_store(kind, tmp_path, request, caplog):
    place = tmp_path / "work" if kind == "folder" else f"{request.getfixturevalue('bucket')}/entries"
    store = open_store(place)
    assert store.read("abc") is None
    store.write("abc", b"first")
    store.write("abc", b"second")
    assert store.read("abc") == b"second" and store.place.paths() == ["ab/abc"]
    whole = seal("abc", b"second")
    for damaged in (whole[:-1], whole[:-1] + b"D", b"", b"second", seal("abd", b"second")):
        store.place.write("ab/abc", damaged)
        assert store.read("abc") is None
        assert f"{store.place.name}: the stored result abc is damaged or another's, and is made again" in caplog.text
    assert unseal("abc", whole) == b"second"
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match="expected a folder for work, got a file"):
        open_store(tmp_path / "file")
