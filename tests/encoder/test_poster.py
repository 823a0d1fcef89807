"""The poster: a small picture of what viewers see first."""

import io

import numpy as np
import pytest
from PIL import Image

from airgs_codec.encoder.pipeline import draw_poster
from airgs_codec.package.tables import MAX_POSTER_BYTES, MAX_POSTER_SIDE
from tests.faces import CPU, POSTER_NAME, levelled, open_package, open_sequence, place_view, psnr, to_bytes, with_pixels
from tests.support.paths import FOX


def test_a_package_has_a_view_of_its_first_frame_from_where_viewers_begin(demo_package):
    package = open_package(demo_package)
    m = package.manifest
    data = package.read(POSTER_NAME)
    assert 0 < len(data) <= MAX_POSTER_BYTES
    with Image.open(io.BytesIO(data)) as opened:
        assert (opened.format, max(opened.size)) == ("JPEG", MAX_POSTER_SIDE)
        poster = np.asarray(opened.convert("RGB"))
    camera = place_view(m.region, levelled(m.region, m.world).places[0])
    camera = with_pixels(camera, *poster.shape[1::-1])
    expected = to_bytes(CPU.render(open_sequence(FOX).load([0]).frames[0], camera).rgb)
    assert psnr(float(np.square((poster.astype(float) - expected) / 255).mean())) > 30  # what JPEG loses


@pytest.mark.parametrize("most", [20_000, 5_000, 900])
def test_it_is_worse_and_then_smaller_until_it_fits(most, monkeypatch):
    monkeypatch.setattr("airgs_codec.encoder.pipeline.MAX_POSTER_BYTES", most)
    sequence = open_sequence(FOX)
    data = draw_poster(sequence, 0, sequence.cameras[0], CPU)
    with Image.open(io.BytesIO(data)) as opened:
        assert len(data) <= most and opened.size[0] == opened.size[1] <= MAX_POSTER_SIDE
