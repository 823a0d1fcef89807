"""Where calibrations are kept: one small JSON file a scene, under the user's cache folder."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

from airgs_codec import __version__
from airgs_codec._files import write_bytes
from airgs_codec.coding.steps import StepSettings
from airgs_codec.encoder.calibrate import REVISION, Calibration
from airgs_codec.encoder.settings import EncodeSettings, LevelSettings
from airgs_codec.encoder.survey import ViewPlan
from airgs_codec.errors import AirgsError
from airgs_codec.jobs.digest import digest
from airgs_codec.media.h264 import library_versions
from airgs_codec.package.tables import KeySteps, StateSteps


def folder() -> Path:
    """Where calibrations are: $XDG_CACHE_HOME/airgs-codec/calibration, or the same under ~/.cache."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "airgs-codec" / "calibration"


def name_of(frames: str, views: ViewPlan, settings: EncodeSettings) -> str:
    """SHA-256 of everything that a calibration depends on.

    That is every frame of the group, since the repair of one frame changes the rows of all, and the usage that the
    trainer left, all of which `frames` names; the views that decide, the settings and the versions of the code.
    """
    choices = replace(
        settings, quality=1.0, calibrate="none", tiles=1, measure_pictures=0, threads=1, device="auto", world=None
    )
    return digest(
        __version__, REVISION, library_versions(), choices, frames, views.deciding, views.trusted, views.renderer
    )


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
