"""AirGS codec: dynamic 3D Gaussian Splatting scenes as H.264 pictures, pruning levels and a DASH manifest.

    import airgs_codec as airgs

    airgs.encode("scene/", "scene.airgs", airgs.EncodeSettings(quality=0.6))
    package = airgs.open_package("scene.airgs")
    gaussians = airgs.decode(package, 12, level="L1", key_quality="Q0")
    airgs.draw(gaussians, package.cameras[0]).save("frame.png")
    log = airgs.simulate(package, "lte.csv", "robust-mpc")

These names are the interface; modules behind them may move. Each is loaded when it is first used, so that importing the
package costs nothing. Paths are `str` or `Path` everywhere, and one stands for what is there wherever an open package,
sequence or trace is expected. All errors raised on purpose are `AirgsError`.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from airgs_codec.decoder.decode import decode, decode_frames
    from airgs_codec.encoder.publish import encode
    from airgs_codec.encoder.search import Goal
    from airgs_codec.encoder.settings import EncodeSettings
    from airgs_codec.errors import AirgsError
    from airgs_codec.inspect.compare import compare
    from airgs_codec.inspect.errors import input_rows
    from airgs_codec.inspect.validate import validate
    from airgs_codec.package.package import Package, open_package
    from airgs_codec.play.ladder import Decision
    from airgs_codec.play.playout import SessionSettings
    from airgs_codec.play.policies import PlayerState
    from airgs_codec.play.session import simulate
    from airgs_codec.play.trace import Trace
    from airgs_codec.render.backend import draw
    from airgs_codec.scene.camera import Camera
    from airgs_codec.scene.formats.table import read, write
    from airgs_codec.scene.gaussians import Gaussians
    from airgs_codec.scene.sequence import GaussianSequence as Sequence
    from airgs_codec.scene.sequence import open_sequence
    from airgs_codec.trainer import train
    from airgs_codec.trainer.settings import TrainSettings

__version__ = "0.1.0"

__all__ = [
    "AirgsError",
    "Camera",
    "Decision",
    "EncodeSettings",
    "Gaussians",
    "Goal",
    "Package",
    "PlayerState",
    "Sequence",
    "SessionSettings",
    "Trace",
    "TrainSettings",
    "compare",
    "decode",
    "decode_frames",
    "draw",
    "encode",
    "input_rows",
    "open_package",
    "open_sequence",
    "read",
    "simulate",
    "train",
    "validate",
    "write",
]

_HOMES = {
    "AirgsError": "errors",
    "Camera": "scene.camera",
    "Decision": "play.ladder",
    "EncodeSettings": "encoder.settings",
    "Gaussians": "scene.gaussians",
    "Goal": "encoder.search",
    "Package": "package.package",
    "PlayerState": "play.policies",
    "Sequence": "scene.sequence",
    "SessionSettings": "play.playout",
    "Trace": "play.trace",
    "TrainSettings": "trainer.settings",
    "compare": "inspect.compare",
    "decode": "decoder.decode",
    "decode_frames": "decoder.decode",
    "draw": "render.backend",
    "encode": "encoder.publish",
    "input_rows": "inspect.errors",
    "open_package": "package.package",
    "open_sequence": "scene.sequence",
    "read": "scene.formats.table",
    "simulate": "play.session",
    "train": "trainer",
    "validate": "inspect.validate",
    "write": "scene.formats.table",
}
_NAMES_THERE = {"Sequence": "GaussianSequence"}  # where it is another


def __getattr__(name: str) -> Any:
    """The public name `name`, from the module that defines it (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), _NAMES_THERE.get(name, name))
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
