"""Sound that says when it is: a tone whose pitch rises steadily. Samples are mono, -1 to 1."""

from __future__ import annotations

import wave
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from numpy.typing import NDArray

from tests.faces import EncodeSettings, encode, encode_sound, open_sequence
from tests.support.scenes import moving_frames, write_sequence

SOUNDING = EncodeSettings(calibrate="none", measure_pictures=0, preset="veryfast", threads=2)
LOWEST, RISE = 400.0, 400.0  # Hz, Hz a second


def chirp(seconds: float, rate: int = 48_000) -> NDArray[np.float64]:
    t = np.arange(round(seconds * rate)) / rate
    return 0.5 * np.sin(2 * np.pi * (LOWEST * t + RISE / 2 * t**2))


def write_chirp(path: Path, seconds: float, channels: int = 1, rate: int = 44_100) -> Path:
    samples = np.round(32767 * chirp(seconds, rate)).astype("<i2")
    return write_wav(path, np.repeat(samples[:, None], channels, 1), rate)


def write_wav(path: Path, samples: NDArray[np.int16], rate: int = 48_000) -> Path:
    with wave.open(str(path), "wb") as file:
        file.setparams((samples.shape[1], 2, rate, len(samples), "NONE", ""))
        file.writeframes(samples.tobytes())
    return path


def moment(samples: NDArray[np.float64], rate: int = 48_000) -> float:
    """The time, in seconds of the chirp, of the middle of some of its samples."""
    spectrum = np.abs(np.fft.rfft(samples * np.hanning(len(samples)), 1 << 17))
    return (np.argmax(spectrum) * rate / (1 << 17) - LOWEST) / RISE


def write_chirping(root: Path, frames: int, fps: Fraction, group_frames: int) -> Path:
    """A package of a small scene that moves, with a chirp as long as it."""
    sequence = open_sequence(write_sequence(root / "scene", moving_frames(40, frames)), fps=fps)
    sound = encode_sound(write_chirp(root / "chirp.wav", float(frames / fps)), frames / fps)
    encode(replace(sequence, sound_track=sound), root / "chirping", replace(SOUNDING, group_frames=group_frames))
    return root / "chirping"


def read_samples(film: Path) -> NDArray[np.float64]:
    """(n,) samples of the first channel of a film, 48,000 a second."""
    with av.open(str(film)) as container:
        parts = [frame.to_ndarray()[0] for frame in container.decode(audio=0)]
    return np.concatenate(parts).astype(np.float64)
