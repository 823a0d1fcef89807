"""Settings say what each of their fields means, in help texts and to help()."""

from dataclasses import dataclass, fields

import pytest

import airgs_codec as airgs
from airgs_codec._settings import about, computed_setting, documented, setting
from tests.faces import TrainSettings


@documented
@dataclass(frozen=True, slots=True)
class Example:
    """Two things."""

    size: int = setting(3, "how many, in pixels")
    names: list[str] = computed_setting(list, "what they are called")


def test_a_field_has_its_default_its_meaning_and_a_line_in_the_docstring():
    assert Example() == Example(3, [])
    assert Example().names is not Example().names
    assert about(Example, "size") == "how many, in pixels"
    assert Example.__doc__ == "Two things.\n\nsize = 3: how many, in pixels.\nnames: what they are called."
    with pytest.raises(KeyError):
        about(Example, "colour")


@pytest.mark.parametrize("settings", [airgs.EncodeSettings, airgs.SessionSettings, TrainSettings])
def test_every_field_of_the_settings_is_explained(settings):
    for field in fields(settings):
        assert f"\n{field.name}" in settings.__doc__
        assert about(settings, field.name)
