"""Where calibrations are kept: one small JSON file a scene, under the user's cache folder."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from airgs_codec import __version__
from airgs_codec.coding.steps import StepSettings
from airgs_codec.encoder.calibration.solve import REVISION, Calibration
from airgs_codec.encoder.plan import Survey
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.errors import AirgsError
from airgs_codec.media.h264 import library_versions
from airgs_codec.package.staging import write_file
from airgs_codec.package.tables import KeySteps, StateSteps
from airgs_codec.render import Camera
from airgs_codec.scene.sequence import GaussianSequence


def folder() -> Path:
    """$XDG_CACHE_HOME/airgs-codec/calibration, or the same under ~/.cache."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "airgs-codec" / "calibration"


def digest(sequence: GaussianSequence, survey: Survey, cameras: Sequence[Camera], settings: EncodeSettings) -> str:
    """Of everything that a calibration depends on; of the group's frames, those that were looked at."""
    h = hashlib.sha256()
    choices = dataclasses.asdict(dataclasses.replace(settings, quality=1.0, calibrate="none", measure_frames=0, jobs=1))
    words = [__version__, REVISION, library_versions(), choices, str(sequence.fps), survey.start, survey.stop]
    h.update(json.dumps(words, sort_keys=True).encode())
    for camera in cameras:
        for field in dataclasses.fields(camera):
            value = getattr(camera, field.name)
            h.update(value.tobytes() if isinstance(value, np.ndarray) else repr(value).encode())
    for frame in survey.shown:
        g = sequence.read(frame)
        for field in dataclasses.fields(g):
            h.update(np.ascontiguousarray(getattr(g, field.name)).tobytes())
    return h.hexdigest()


def load(name: str) -> Calibration | None:
    """What was kept under a digest; None if nothing, or nothing that can be read."""
    try:
        data: dict[str, Any] = json.loads((folder() / f"{name}.json").read_text(encoding="utf-8"))
        steps = data.pop("steps")
        key, state = KeySteps(**steps.pop("key")), StateSteps(**steps.pop("state"))
        levels = tuple((float(share), float(factor)) for share, factor in data.pop("levels"))
        tiers, factors = tuple(data.pop("tiers")), tuple(data.pop("key_factors"))
        return Calibration(
            steps=StepSettings(key=key, state=state, **steps), levels=levels, tiers=tiers, key_factors=factors, **data
        )
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return None


def keep(name: str, calibration: Calibration) -> None:
    """Write it; a cache that cannot be written is no reason to fail."""
    with contextlib.suppress(OSError, AirgsError):
        folder().mkdir(parents=True, exist_ok=True)
        write_file(folder(), f"{name}.json", json.dumps(dataclasses.asdict(calibration)).encode())
