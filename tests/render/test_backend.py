"""The choice of what draws."""

import importlib.machinery
import sys

import numpy as np
import pytest

from airgs_codec.errors import ConfigError
from airgs_codec.render import backend, cpu
from tests.support.scenes import random_gaussians
from tests.support.views import ring


def test_the_cpu_draws_bit_for_bit_what_its_functions_do():
    g, cameras = random_gaussians(100, 1), ring(2, size=40)
    loaded = backend.CPU.load(g)
    for camera in cameras:
        np.testing.assert_array_equal(loaded.draw(camera).rgb, cpu.render(g, camera).rgb)
        np.testing.assert_array_equal(backend.CPU.render(g, camera, (0.1, 0.2, 1)).rgb,
                                      cpu.render(g, camera, (0.1, 0.2, 1)).rgb)  # fmt: skip
        a, b = backend.CPU.measure_contribution(g, camera), cpu.measure_contribution(g, camera)
        assert (a.total == b.total).all() and (a.peak == b.peak).all() and (a.hits == b.hits).all()


def test_a_device_that_cannot_run_is_refused_and_auto_takes_the_cpu(monkeypatch):
    monkeypatch.setattr(backend, "find_spec", lambda name: None if name == "gsplat" else importlib.machinery)
    assert backend.open_renderer("auto") is backend.open_renderer("cpu") is backend.CPU
    with pytest.raises(ConfigError, match="--device cuda: gsplat is not installed: pip install"):
        backend.open_renderer("cuda")
    with pytest.raises(ConfigError, match="expected auto, cpu, cuda, got gpu"):
        backend.open_renderer("gpu")


def test_auto_takes_cuda_where_gsplat_runs(monkeypatch):
    monkeypatch.setattr(backend, "_missing", lambda: None)
    assert backend.open_renderer("auto").device == backend.open_renderer("cuda").device == "cuda"
    assert "gsplat" not in sys.modules
