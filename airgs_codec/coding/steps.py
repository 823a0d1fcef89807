"""The quantiser steps of a scene, before a quality factor and after it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from airgs_codec.package.tables import KEY_ATTRIBUTES, STATE_ATTRIBUTES, KeySteps, StateSteps


@dataclass(frozen=True, slots=True)
class StepSettings:
    """Quantiser steps at quality factor 1; lengths are in motion units (see `motion`).

    Calibration starts from the defaults, which lie between what the walking fox and the N3DV spinach scene ask for.
    """

    key: KeySteps = field(
        default_factory=lambda: KeySteps(quaternions=0.025, log_scales=0.08, opacity=0.014, sh_dc=0.036, sh_rest=0.04)
    )
    state: StateSteps = field(
        default_factory=lambda: StateSteps(
            means=0.0007, quaternions=0.03, log_scales=0.12, opacity=0.058, sh_dc=0.063, sh_rest=0.08
        )
    )
    grid: float = 0.0007  # side of the cells of canonical means, in motion units
    rows: float = 0.0027  # error of pictures (RMS, of [0, 1]) that leaving out Gaussians may make

    def scaled(self, quality: float) -> StepSettings:
        """These steps times a quality factor; `rows`, an error of pictures, stays."""
        key = KeySteps(*(getattr(self.key, name) * quality for name in KEY_ATTRIBUTES))
        state = StateSteps(*(getattr(self.state, name) * quality for name in STATE_ATTRIBUTES))
        return replace(self, key=key, state=state, grid=self.grid * quality)
