"""Settings: what is refused, tables."""

import json

import pytest

from airgs_codec.errors import ConfigError
from airgs_codec.places.whole import to_json
from airgs_codec.trainer.settings import Temporal, TrainSettings, preset, settings_from_table


@pytest.mark.parametrize(
    "wrong",
    [
        {"budget": 0},
        {"budget": 6, "capacity": 5},
        {"sh_degree": 4},
        {"deltas": "x"},
        {"densify": "x"},
        {"max_drop_db": 0.0},
        {"temporal": Temporal(until=0.0)},
    ],
)
def test_settings_that_cannot_work_are_refused(wrong):
    with pytest.raises(ConfigError, match="expected"):
        TrainSettings(**wrong)


@pytest.mark.parametrize("name", ["default", "paper"])
def test_settings_come_back_from_their_table(name):
    settings = preset(name, TrainSettings(seed=3, max_size=64))
    assert settings_from_table(json.loads(to_json(settings.table()))) == settings


@pytest.mark.parametrize(("views", "expected"), [(16, 2500), (84, 5040)])
def test_a_first_frame_sees_every_view_often(views, expected):
    assert TrainSettings().iterations_from_scratch(views) == expected
    assert TrainSettings(first_iterations=7).iterations_from_scratch(views) == 7
