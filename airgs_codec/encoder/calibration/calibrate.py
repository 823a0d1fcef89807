"""The steps and the ladder that one scene asks for, found on one of its groups."""

from __future__ import annotations

from dataclasses import dataclass, replace

from airgs_codec.coding.steps import StepSettings
from airgs_codec.encoder.calibration.ladder import (
    FACTORS,
    Withholding,
    choose_shares,
    choose_tiers,
    key_factors,
    make_levels,
)
from airgs_codec.encoder.calibration.solve import guess_price, solve_steps
from airgs_codec.encoder.calibration.subject import Subject
from airgs_codec.encoder.settings import EncodeSettings, LevelSettings, Shares
from airgs_codec.encoder.survey import Survey
from airgs_codec.scene.sequence import GaussianSequence

REVISION = 6  # of this method, for the cache


@dataclass(frozen=True, slots=True)
class Calibration:
    """What a scene asks for at quality 1; the fields are those of EncodeSettings."""

    steps: StepSettings
    levels: tuple[LevelSettings, ...]
    tiers: tuple[float, ...]
    key_factors: tuple[float, ...]
    shares: Shares
    byte_price: float
    expected: float  # mean squared error of pictures of the top rung

    def apply(self, settings: EncodeSettings) -> EncodeSettings:
        """Settings of an encode: what `settings.calibrate` asks for is replaced, and nothing is left to calibrate."""
        chosen = replace(settings, calibrate="none", steps=self.steps, byte_price=self.byte_price)
        if settings.calibrate != "ladder":
            return chosen
        ladder = replace(chosen, levels=self.levels, tiers=self.tiers, key_factors=self.key_factors, shares=self.shares)
        return ladder.at(settings.quality)


def calibrate(sequence: GaussianSequence, survey: Survey, settings: EncodeSettings) -> Calibration:
    """Calibrate on the group of `survey`, starting at `settings.steps`, at quality 1.

    Which updates the top level withholds decides what states cost, so that it is guessed before steps are solved for.
    """
    subject = Subject.of(sequence, survey, replace(settings, quality=1.0, tiles=1))
    sample, withholding = subject.sample(float(sequence.fps)), Withholding.of(subject)
    top = sample
    if settings.calibrate == "ladder":
        guess = guess_price(sample, subject)
        shares, _ = choose_shares(sample, withholding, settings.steps, guess, (1.0,), settings.threads)
        top = replace(sample, moving=withholding.kept(sample, shares[0][1])) if shares else sample
    steps, price = solve_steps(top, subject)
    shares, expected = choose_shares(sample, withholding, steps, price, FACTORS, settings.threads)
    if subject.layout.removal_error > 0:
        expected += subject.pruning.within(steps.rows).error
    if not shares:
        return Calibration(steps, (LevelSettings(0.0),), (1.0,), (1.0,), (), price, expected)
    tiers = choose_tiers(top, subject, steps, price)
    return Calibration(steps, make_levels(len(tiers)), tiers, key_factors(), shares, price, expected)
