"""What holds the pictures of a package back most is named."""

from dataclasses import replace

import pytest

from airgs_codec.coding.quantize import StepSettings
from airgs_codec.encoder.batch import encode_sequence
from airgs_codec.encoder.search import LEFT_OUT, find_limit
from airgs_codec.encoder.settings import EncodeSettings, LevelSettings
from airgs_codec.encoder.survey import ViewPlan
from airgs_codec.jobs.work import temporary_work
from airgs_codec.scene.sequence import open_sequence
from tests.support.jobs import prepared_as_one_group
from tests.support.regions import place, region
from tests.support.scenes import moving_frames, write_sequence

FINE = StepSettings()
COARSE = {
    "sizes": replace(FINE, key=replace(FINE.key, log_scales=2.0), state=replace(FINE.state, log_scales=2.0)),
    "colours": replace(FINE, key=replace(FINE.key, sh_dc=2.0), state=replace(FINE.state, sh_dc=2.0)),
    "positions": replace(FINE, grid=4.0, state=replace(FINE.state, means=4.0)),
    LEFT_OUT: replace(FINE, rows=0.2),
}


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A small moving scene."""
    sequence = open_sequence(write_sequence(tmp_path_factory.mktemp("limits") / "scene", moving_frames(200, 3)))
    views = ViewPlan.of(sequence, 6, region=replace(region(place(0.0)), width=96, height=72))
    with temporary_work() as work:
        yield prepared_as_one_group(sequence, views, work), work


@pytest.mark.parametrize("part", COARSE)
def test_the_part_that_is_coarse_is_named(scene, part):
    settings = EncodeSettings(
        calibrate="none",
        levels=(LevelSettings(0.0),),
        tiers=(1.0,),
        key_factors=(1.0,),
        steps=COARSE[part],
        preset="ultrafast",
    )
    prepared, work = scene
    assert find_limit(encode_sequence(prepared, settings, work), prepared)[0] == part
