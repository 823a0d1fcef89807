"""A contact sheet shows what each camera sees, whatever its shape."""

from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.errors import ConfigError
from airgs_codec.inspect.contact_sheet import SIDE, write_contact_sheet
from airgs_codec.media.image import read_picture
from tests.support.scenes import random_gaussians
from tests.support.views import coloured_cloud, ring


def test_every_camera_has_its_tile(tmp_path):
    wide, *others = ring(5, 300)
    cameras = [replace(wide, width=600, cx=300.0), *others[1:], ring(1, 48)[0]]
    file = tmp_path / "sheet.png"
    write_contact_sheet(file, coloured_cloud(), cameras, ["score 0.12"])
    sheet = read_picture(file)
    assert sheet.shape == (2 * SIDE, 4 * SIDE, 3)
    bodies = [sheet[y + 40 : y + SIDE, x : x + SIDE] for y in (0, SIDE) for x in range(0, 4 * SIDE, SIDE)]
    assert [bool(body.any()) for body in bodies] == [True] * 5 + [False] * 3
    assert not bodies[0][-SIDE // 8 :].any() and bodies[0].any(), "a wide picture is not stretched"


def test_broken_rows_are_passed_over(tmp_path):
    g = random_gaussians(30)
    means = g.means.copy()
    means[3] = np.nan
    write_contact_sheet(tmp_path / "sheet.png", replace(g, means=means), ring(2))
    assert read_picture(tmp_path / "sheet.png").any()


def test_what_cannot_be_drawn_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="at least one camera"):
        write_contact_sheet(tmp_path / "sheet.png", random_gaussians(5), [])
    with pytest.raises(ConfigError, match="cannot write"):
        write_contact_sheet(tmp_path / "missing" / "sheet.png", random_gaussians(5), ring(2))
