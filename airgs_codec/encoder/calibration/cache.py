"""Where calibrations are kept: one small JSON file a scene, under the user's cache folder."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from airgs_codec import __version__
from airgs_codec._files import write_bytes
from airgs_codec.coding.steps import StepSettings
from airgs_codec.encoder.calibration.calibrate import REVISION, Calibration
from airgs_codec.encoder.settings import EncodeSettings, LevelSettings
from airgs_codec.encoder.survey import Survey
from airgs_codec.encoder.views import ViewPlan
from airgs_codec.errors import AirgsError
from airgs_codec.media.h264 import library_versions
from airgs_codec.package.tables import KeySteps, StateSteps
from airgs_codec.scene.sequence import GaussianSequence


def folder() -> Path:
    """Where calibrations are: $XDG_CACHE_HOME/airgs-codec/calibration, or the same under ~/.cache."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "airgs-codec" / "calibration"


def digest(sequence: GaussianSequence, survey: Survey, views: ViewPlan, settings: EncodeSettings) -> str:
    """SHA-256 of everything that a calibration depends on.

    That is every frame of the group, since the repair of one frame changes the rows of all, the usage that the trainer
    left, the views that decide, the settings and the versions of the code.
    """
    h = hashlib.sha256()
    choices = dataclasses.replace(settings, quality=1.0, calibrate="none", measure_pictures=0, jobs=1, world=None)
    choices = dataclasses.replace(choices, device="auto")
    versions = [__version__, REVISION, library_versions()]
    words = [*versions, dataclasses.asdict(choices), str(sequence.fps), views.trusted, dataclasses.astuple(survey.span)]
    h.update(json.dumps(words, sort_keys=True).encode())
    usage = sequence.usage(survey.span.start, survey.span.stop)
    for value in [*views.deciding, *([] if usage is None else [usage])]:
        _update(h, value)
    for frame in range(survey.span.start, survey.span.stop):
        _update(h, sequence.read(frame))
    return h.hexdigest()


def _update(h: hashlib._Hash, value: Any) -> None:
    """Add the fields of a dataclass of arrays and plain values."""
    for field in dataclasses.fields(value):
        part = getattr(value, field.name)
        h.update(np.ascontiguousarray(part).tobytes() if isinstance(part, np.ndarray) else repr(part).encode())


def load(name: str) -> Calibration | None:
    """The calibration kept under a digest; None if there is none, or none that can be read."""
    try:
        data: dict[str, Any] = json.loads((folder() / f"{name}.json").read_text(encoding="utf-8"))
        steps = data.pop("steps")
        key, state = KeySteps(**steps.pop("key")), StateSteps(**steps.pop("state"))
        levels = tuple(LevelSettings(**level) for level in data.pop("levels"))
        tiers, factors = tuple(data.pop("tiers")), tuple(data.pop("key_factors"))
        shares = tuple((float(factor), float(share)) for factor, share in data.pop("shares"))
        whole = StepSettings(key=key, state=state, **steps)
        return Calibration(steps=whole, levels=levels, tiers=tiers, key_factors=factors, shares=shares, **data)
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return None


def keep(name: str, calibration: Calibration) -> None:
    """Keep a calibration under a digest; a cache that cannot be written is no reason to fail."""
    with contextlib.suppress(OSError, AirgsError):
        folder().mkdir(parents=True, exist_ok=True)
        write_bytes(folder() / f"{name}.json", json.dumps(dataclasses.asdict(calibration)).encode())
