"""The steps and the ladder that one scene asks for, found on one of its groups."""

from __future__ import annotations

from dataclasses import dataclass, replace

from airgs_codec.coding.steps import StepSettings
from airgs_codec.encoder.calibration.ladder import choose_levels, choose_tiers, key_factors
from airgs_codec.encoder.calibration.solve import solve_steps
from airgs_codec.encoder.calibration.subject import Subject
from airgs_codec.encoder.settings import EncodeSettings, LevelSettings
from airgs_codec.encoder.survey import Survey
from airgs_codec.scene.sequence import GaussianSequence

REVISION = 2  # of this method, for the cache


@dataclass(frozen=True, slots=True)
class Calibration:
    """What a scene asks for at quality 1; the fields are those of EncodeSettings."""

    steps: StepSettings
    levels: tuple[LevelSettings, ...]
    tiers: tuple[float, ...]
    key_factors: tuple[float, ...]
    byte_price: float

    def apply(self, settings: EncodeSettings) -> EncodeSettings:
        """Settings of an encode: what `settings.calibrate` asks for is replaced, and nothing is left to calibrate."""
        chosen = replace(settings, calibrate="none", steps=self.steps, byte_price=self.byte_price)
        if settings.calibrate != "ladder":
            return chosen
        return replace(chosen, levels=self.levels, tiers=self.tiers, key_factors=self.key_factors)


def calibrate(sequence: GaussianSequence, survey: Survey, settings: EncodeSettings) -> Calibration:
    """Calibrate on the group of `survey`, starting at `settings.steps`, at quality 1."""
    subject = Subject.of(sequence, survey, replace(settings, quality=1.0))
    sample = subject.sample(float(sequence.fps))
    steps, price = solve_steps(sample, subject)
    levels = choose_levels(sample, subject, steps, price)
    if len(levels) == 1:
        return Calibration(steps, levels, (1.0,), (1.0,), price)
    return Calibration(steps, levels, choose_tiers(subject, steps), key_factors(), price)
