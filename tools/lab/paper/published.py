"""What the AirGS paper (arXiv 2512.20943) publishes, on HiFi4G with an RTX 3090: printed beside ours, never mixed."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Published:
    """A row of the paper's Table 1, with the keyframe time of its Table 2."""

    method: str
    psnr: float  # dB
    ssim: float
    mb_frame: float
    train_min_frame: float
    fps: float
    transmission_s: float
    key_min: float | None


TABLE = (
    Published("NeuS2", 29.82, 0.961, 24.5, 3.7, 3, 0.139, 4.62),
    Published("naive 3DGS", 33.94, 0.987, 18.3, 9.8, 200, 0.122, None),
    Published("4DGS", 29.95, 0.971, 12.0, 9.0, 60, 0.131, None),
    Published("3DGStream", 25.33, 0.944, 7.8, 0.75, 215, 0.063, None),
    Published("V³", 27.69, 0.949, 2.0, 1.5, 387, 0.021, 2.98),
    Published("AirGS", 32.29, 0.987, 1.1, 1.4, 400, 0.011, 0.61),
)
PROTOCOL = (
    "The paper: seven sequences of HiFi4G, 3840 x 2160, 81 cameras of which ten are held out, 30 frames a second, an "
    "RTX 3090, LTE driving traces. Here: other scenes, smaller pictures, two CPU cores. Only the order of methods and "
    "ratios within a table can be compared, and those with care."
)
