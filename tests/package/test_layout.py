"""The channel table is the one of FORMAT.md, section 5, and every way to ask it agrees."""

import re

import numpy as np
import pytest

from airgs_codec.package.layout import COLOUR
from tests.faces import KEY, STATE, KeySteps, StateSteps
from tests.support.paths import REPOSITORY

COLOURS = 12


def format_table(kind):
    """(channels, value, step) of every row of the table of key or state channels in FORMAT.md."""
    section = (REPOSITORY / "FORMAT.md").read_text().split("## 5.")[1].split("## 6.")[0]
    table = section.split(f"| {kind} channel |")[1].split("\n\n")[0].splitlines()[2:]
    return [tuple(cell.strip() for cell in line.strip("| ").split("|")) for line in table]


def places(text, colours):
    """The channels that a cell such as `0–2`, `6` or `7 … 6 + C` names."""
    numbers = [int(number) for number in re.findall(r"\d+", text)]
    last = numbers[-1] + colours if "C" in text else numbers[-1]
    return list(range(numbers[0], last + 1))


@pytest.mark.parametrize(("layout", "steps"), [(KEY, "key_steps"), (STATE, "state_steps")], ids=["key", "state"])
def test_the_format_lists_the_same_channels_in_the_same_order(layout, steps):
    rows = format_table(layout.kind)
    assert len(rows) == len(layout.attributes)
    for (channels, _, step), attribute in zip(rows, layout.attributes, strict=True):
        wanted = places(channels, COLOURS)
        assert list(range(layout.width(COLOURS)))[layout.slice(attribute)] == wanted
        assert {layout.attribute_of(channel) for channel in wanted} == {attribute}
        assert step == ("1" if attribute == COLOUR else f"`{steps}.{attribute}`")


def test_the_index_of_attributes_and_the_slices_agree():
    for layout in (KEY, STATE):
        index = layout.attribute_index(layout.width(COLOURS))
        for place, attribute in enumerate(layout.attributes):
            assert (index[layout.slice(attribute)] == place).all()
        assert np.array_equal(np.sort(index), index)


def test_steps_stand_in_channel_order_and_colour_counts_in_steps_already():
    assert KEY.steps(KeySteps(2.0, 1.0, 3.0, 9.0, 9.0), 3).tolist() == [1.0] * 3 + [2.0] * 3 + [3.0] + [1.0] * 3
    state = STATE.steps(StateSteps(4.0, 2.0, 1.0, 3.0, 9.0, 9.0), 3).tolist()
    assert state == [4.0] * 3 + [1.0] * 3 + [2.0] * 3 + [3.0] + [1.0] * 3


def test_an_attribute_that_a_kind_does_not_have_is_an_error():
    with pytest.raises(KeyError):
        KEY.slice("means")
