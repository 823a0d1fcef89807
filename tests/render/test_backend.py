"""The choice of what draws."""

import importlib.machinery
import sys

import pytest

from airgs_codec.errors import ConfigError
from airgs_codec.render import backend


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
