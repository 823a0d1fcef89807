"""Names of content tell values apart by what they hold, not by who holds them."""

from dataclasses import dataclass

import numpy as np
import pytest

from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.jobs.digest import digest


@dataclass
class Pair:
    first: object
    second: object


def test_equal_content_has_one_name_and_any_change_another():
    table = np.arange(6, dtype=np.float32).reshape(2, 3)
    values = [
        1, 1.0, True, "1", b"1", None, (1,), [[1]], {"a": 1}, {"b": 1}, Pair(1, 2), Pair(2, 1), Pair((1, 2), ()),
        table, table.T, table.reshape(3, 2), table.astype(np.float64), np.nan,
        EncodeSettings(), EncodeSettings(quality=2.0),
    ]  # fmt: skip
    names = [digest(value) for value in values]
    assert len(set(names)) == len(values)
    assert digest(table.T.copy()) == digest(table.T)
    assert digest({"a": 1, "b": 2}) == digest({"b": 2, "a": 1})
    assert digest((1, 2)) == digest([1, 2]) and digest("ab", "c") != digest("a", "bc")


@pytest.mark.parametrize("value", [object(), {1, 2}, print, [object()]])
def test_what_has_no_content_is_refused(value):
    with pytest.raises(TypeError):
        digest(value)
