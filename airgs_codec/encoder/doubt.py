"""How sure is what pictures show of the rungs of a package. S segments."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri, stdtrit

from airgs_codec.media.metrics import Difference

MANY = 2  # pictures of each place, on average, from which places tell how much of an error is theirs
CONFIDENCE = 0.975  # that a mean is not more than two standard errors too low

Rung = tuple[int, int]  # level, key quality


@dataclass(frozen=True, slots=True)
class RungSeen:
    """What all rounds so far have shown of a rung in a segment."""

    squared: list[float] = field(default_factory=list)  # mean squared errors
    top: list[float] = field(default_factory=list)  # those of the top rung in the same pictures
    places: list[int] = field(default_factory=list)  # that these are seen from
    alike: list[Difference] = field(default_factory=list)  # of the first round's


Seen = dict[int, dict[Rung, RungSeen]]  # by segment


def doubt_db(unsure: float) -> float:
    """Two relative standard errors of a mean squared error, in dB of PSNR."""
    return 10 * math.log10(1 + 2 * unsure)


def doubt_of_top(parts: Sequence[RungSeen], shares: NDArray[np.float64]) -> float:
    """Relative standard error of the mean squared error of the top rung in some segments; 0 without error."""
    squared = [np.array(part.squared) for part in parts]
    mean = float(shares @ [of.mean() for of in squared])
    return _standard_error(squared, parts, shares) / mean if mean else 0.0


def doubt_of_ratio(parts: Sequence[RungSeen], shares: NDArray[np.float64]) -> float:
    """Relative standard error of what a rung's mean squared error is to that of the top one; 0 without error.

    One ratio for all segments.
    """
    own, top = shares @ [(np.mean(part.squared), np.mean(part.top)) for part in parts]
    if not own:
        return 0.0
    left = [np.array(part.squared) - (own / top * np.array(part.top) if top else 0.0) for part in parts]
    return _standard_error(left, parts, shares) / float(own)


def _standard_error(errors: Sequence[NDArray], parts: Sequence[RungSeen], shares: NDArray[np.float64]) -> float:
    """Standard error of the mean of errors in pictures of some segments, each with its share; infinite for one picture.

    Segments and places differ, and all of them are looked at: only what neither explains is left to chance, and that
    not all places are looked at equally often (post-stratification; Cochran, chapter 5A). Places tell nothing where
    pictures are too few. Of few pictures it is as much larger as Student's t is than a normal distribution.
    """
    counts, left = np.array([len(of) for of in errors]), np.concatenate(errors)
    segments = np.repeat(np.arange(len(counts)), counts) if len(left) > len(counts) else np.zeros(len(left), np.intp)
    weights, uneven = np.repeat(shares / counts, counts), 0.0
    left, free = _without_means(left, segments)
    _, places = np.unique(np.concatenate([part.places for part in parts]), return_inverse=True)
    looked = np.bincount(places)
    if len(left) >= MANY * len(looked) and free >= len(looked):
        effects = np.bincount(places, left) / looked
        left, free = left - effects[places], free - len(looked) + 1
        uneven = float(effects @ (np.bincount(places, weights) - 1 / len(looked)))
    if not free:
        return math.inf
    wider = float(stdtrit(free, CONFIDENCE) / ndtri(CONFIDENCE))
    return wider * float((left @ left / free * (weights @ weights) + uneven**2) ** 0.5)


def _without_means(values: NDArray, parts: NDArray[np.intp]) -> tuple[NDArray, int]:
    """Values less the mean of their part, and how many of them are free then."""
    counts = np.bincount(parts)
    return values - (np.bincount(parts, values) / counts)[parts], len(values) - len(counts)


def ratio_of(of: Mapping[Rung, RungSeen], part: RungSeen) -> float:
    """What the top rung's mean squared error in all pictures of a segment is to that in those of a rung.

    1 where these show no error. The top rung is the one with most pictures.
    """
    everywhere = max(of.values(), key=lambda one: len(one.squared))
    mean = np.mean(part.top)
    return float(np.mean(everywhere.top) / mean) if mean else 1.0
