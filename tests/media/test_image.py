"""Images: files come back, lenses are undone, features are found where they are."""

import struct
import zlib

import cv2
import numpy as np
import pytest

from airgs_codec.media import image
from tests.faces import SceneError, read_picture, to_bytes, write_png


def noise(height=48, width=64, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3)).astype(np.uint8)


def test_labels_darken_their_lines_alone_and_a_contact_sheet_has_a_captioned_tile_for_each_picture():
    rgb = np.full((60, 80, 3), 90, np.uint8)
    out = image.label(rgb, "text", 1)
    assert (rgb == 90).all() and (out[:18] == 90).all() and (out[36:] == 90).all() and (out[18:36] != 90).any()
    pictures = [np.full((60, 80, 3), value, np.uint8) for value in (50, 100, 150)]
    sheet = image.contact_sheet(pictures, ["a", "b\nsecond line", "c"], columns=2)
    assert sheet.shape == (120, 160, 3)
    assert (sheet[50, [0, 80]] == [[50] * 3, [100] * 3]).all() and (sheet[110, [0, 159]] == [[150] * 3, [0] * 3]).all()
    assert sheet[30, 90].max() < 100, "the second line is darkened, too"
    with pytest.raises(ValueError):
        image.contact_sheet(pictures, ["a"], columns=2)


def test_pictures_grey_alpha_and_16_bits_are_read_as_rgb_and_floats_are_bytes_within_their_bounds(tmp_path):
    path, rgb = tmp_path / "a.png", noise()
    grey, bgr = np.repeat(rgb[..., :1], 3, axis=2), rgb[..., ::-1]
    write_png(path, rgb)
    np.testing.assert_array_equal(read_picture(path), rgb)
    for written, read in (
        (rgb[..., 0], grey),
        (np.dstack([bgr, rgb[..., 0]]), np.dstack([rgb, rgb[..., 0]])),
        (bgr.astype(np.uint16) << 8 | 7, rgb),
        (rgb[..., 0].astype(np.uint16) << 8 | 7, grey),
    ):
        cv2.imwrite(str(path), written)
        np.testing.assert_array_equal(read_picture(path), read)
    assert to_bytes(np.array([[[-0.5, 0.5, 1.5]]])).tolist() == [[[0, 128, 255]]]


def test_what_is_no_picture_or_has_more_pixels_than_any_camera_is_refused_in_one_line(tmp_path):
    write_png(tmp_path / "a.png", noise())
    whole = (tmp_path / "a.png").read_bytes()
    refused = [("empty", b"", None, ""), ("text", b"no picture", None, ""), ("none", None, None, "")]
    for side in (16_000, 50_000):
        header = whole[12:16] + struct.pack(">II", side, side) + whole[24:29]
        data = whole[:12] + header + struct.pack(">I", zlib.crc32(header)) + whole[33:]
        refused += [("large", data, size, f": .*{side**2} pixels") for size in (None, (64, 48), (side, side))]
    for name, data, size, says in refused:
        if data is not None:
            (tmp_path / name).write_bytes(data)
        with pytest.raises(SceneError, match=f"{name}: expected a picture{says}") as caught:
            read_picture(tmp_path / name, size)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp"])
@pytest.mark.parametrize("read", [read_picture, image.read_mask])
def test_the_size_is_compared_before_pixels_are_decoded(tmp_path, suffix, read):
    """Of a file that ends in the middle of its pixels, only the header can tell."""
    path = tmp_path / f"a{suffix}"
    cv2.imwrite(str(path), noise())
    assert read(path, (64, 48)).shape[:2] == (48, 64)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(SceneError, match="expected a picture of 6x4, got 64x48"):
        read(path, (6, 4))
    with pytest.raises(SceneError, match="truncated"):
        read(path, (64, 48))


def test_a_mask_is_1_where_it_is_not_black(tmp_path):
    path, mask = tmp_path / "m.png", np.zeros((4, 6, 3), np.uint8)
    mask[1, 2], mask[3, 5] = 1, 255
    write_png(path, mask)
    assert np.argwhere(image.read_mask(path, (6, 4))).tolist() == [[1, 2], [3, 5]]


def test_features_of_a_shifted_picture_match_by_the_shift():
    smooth = cv2.GaussianBlur(noise(120, 160), (0, 0), 2).astype(np.float32) / 255
    smooth = (smooth - smooth.min()) / (smooth.max() - smooth.min())
    (a, da), (b, db) = image.sift(smooth[:100, :140], 300), image.sift(smooth[10:110, 15:155], 300)
    pairs = image.match_features(da, db, 0.8)
    assert len(pairs) > 20
    np.testing.assert_allclose(np.median(a[pairs[:, 0]] - b[pairs[:, 1]], axis=0), [15, 10], atol=0.1)
    assert image.match_features(da[:1], db, 0.8).shape == (0, 2)
    assert image.sift(np.zeros((20, 20, 3), np.float32), 10)[1].shape == (0, 128)


def test_a_lens_maps_straight_rays_to_where_opencv_bends_them():
    """A dot drawn where the distorting camera sees a point is found where the pinhole camera sees it."""
    matrix = np.array([[70.0, 0, 50.3], [0, 72.0, 40.1], [0, 0, 1]])
    coefficients = np.array([-0.2, 0.05, 0.002, -0.001])
    lens = image.fit_lens((100, 80), matrix, coefficients)
    point = np.array([[0.25, -0.18, 1.0]])
    centred = matrix - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]
    bent = cv2.projectPoints(point, np.zeros(3), np.zeros(3), centred, coefficients)[0].reshape(2) + 0.5
    rows, columns = np.mgrid[:80, :100] + 0.5
    dot = np.exp(-((columns - bent[0]) ** 2 + (rows - bent[1]) ** 2) / 8).astype(np.float32)
    seen = image.undistort(np.repeat(dot[..., None], 3, axis=2), lens)[..., 0]
    found = np.array([(seen * columns).sum(), (seen * rows).sum()]) / seen.sum()
    assert found == pytest.approx((lens.pinhole @ point[0])[:2], abs=0.15)


@pytest.mark.parametrize(
    ("focal", "cx", "bend", "fisheye", "degrees"),
    [(f, 80, 0, True, 120) for f in (54, 51, 46)]  # of 170 to 200 degrees
    + [(100, 80, 0.5, False, 63), (100, 80, -0.5, False, 66), (100, 80, -1, False, 50), (51, 80, -0.5, True, 81)]
    + [(0.5, 80, 0, True, 0), (5, 80, 0, True, 0), (51, 400, 0, True, 0)]
    + [(100, 500, -0.1, False, 0), (0.01, 80, 0.1, False, 0)],
)
def test_a_pinhole_shows_what_its_lens_shows_once_or_none_is_made(focal, cx, bend, fisheye, degrees):
    matrix = np.array([[focal, 0, cx], [0, focal, 60], [0, 0, 1.0]])
    arguments = (160, 120), matrix, np.array([bend, 0, 0, 0.0]), fisheye
    if not degrees:
        with pytest.raises(ValueError, match="lens"):
            image.fit_lens(*arguments)
        return
    lens = image.fit_lens(*arguments)
    x, y = lens.maps(lens.size)
    assert np.degrees(2 * np.arctan(80 / lens.pinhole[0, 0])) == pytest.approx(degrees, abs=1)
    assert (np.diff(x, axis=1) > 0).all() and (np.diff(y, axis=0) > 0).all() and lens.cut == (bend != 0.5)
