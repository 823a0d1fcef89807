"""Lenses: straight rays are where OpenCV bends them."""

import cv2
import numpy as np
import pytest

from airgs_codec.media.image import fit_lens, undistort


def test_a_lens_maps_straight_rays_to_where_opencv_bends_them():
    """A dot drawn where the distorting camera sees a point is found where the pinhole camera sees it."""
    matrix = np.array([[70.0, 0, 50.3], [0, 72.0, 40.1], [0, 0, 1]])
    coefficients = np.array([-0.2, 0.05, 0.002, -0.001])
    lens = fit_lens((100, 80), matrix, coefficients)
    point = np.array([[0.25, -0.18, 1.0]])
    shift = np.array([0.5, 0.5])
    centred = matrix.copy()
    centred[:2, 2] -= 0.5
    bent = cv2.projectPoints(point, np.zeros(3), np.zeros(3), centred, coefficients)[0].reshape(2) + shift
    rows, columns = np.mgrid[:80, :100] + 0.5
    dot = np.exp(-((columns - bent[0]) ** 2 + (rows - bent[1]) ** 2) / 8).astype(np.float32)
    seen = undistort(np.repeat(dot[..., None], 3, axis=2), lens)[..., 0]
    found = np.array([(seen * columns).sum(), (seen * rows).sum()]) / seen.sum()
    straight = lens.pinhole @ point[0]
    assert found == pytest.approx(straight[:2], abs=0.15)
