"""AirGS codec: dynamic 3D Gaussian Splatting scenes as H.264 pictures, pruning levels and a DASH manifest.

    import airgs_codec as airgs

    airgs.encode("scene/", "scene.airgs", airgs.EncodeSettings(quality=0.6))
    package = airgs.open_package("scene.airgs")
    gaussians = airgs.decode(package, 12, level="L1", keyframe_quality="Q0")
    airgs.draw(gaussians, package.cameras[0]).save("frame.png")
    log = airgs.simulate(package, "lte.csv", "robust-mpc")

These names are the interface; modules behind them may move. Each is loaded when it is first used, so that importing the
package costs nothing. Paths are `str` or `Path` everywhere, and are opened wherever an open package, sequence or trace
is expected. All errors raised on purpose are `AirgsError`.
"""

from __future__ import annotations

from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # `as` tells type checkers that a name is public
    from airgs_codec.decoder.decode import decode as decode
    from airgs_codec.decoder.decode import decode_frames as decode_frames
    from airgs_codec.encoder.decide import decide as decide
    from airgs_codec.encoder.plan import Plan as Plan
    from airgs_codec.encoder.publish import encode as encode
    from airgs_codec.encoder.settings import EncodeSettings as EncodeSettings
    from airgs_codec.encoder.target import Goal as Goal
    from airgs_codec.errors import AirgsError as AirgsError
    from airgs_codec.inspect.compare import compare as compare
    from airgs_codec.inspect.errors import input_rows as input_rows
    from airgs_codec.inspect.validate import validate as validate
    from airgs_codec.package.package import Package as Package
    from airgs_codec.package.package import open_package as open_package
    from airgs_codec.play.ladder import Decision as Decision
    from airgs_codec.play.playout import SessionSettings as SessionSettings
    from airgs_codec.play.policies import PlayerState as PlayerState
    from airgs_codec.play.session import simulate as simulate
    from airgs_codec.play.trace import Trace as Trace
    from airgs_codec.render.backend import draw as draw
    from airgs_codec.scene.camera import Camera as Camera
    from airgs_codec.scene.formats.table import read as read
    from airgs_codec.scene.formats.table import write as write
    from airgs_codec.scene.gaussians import Gaussians as Gaussians
    from airgs_codec.scene.sequence import GaussianSequence
    from airgs_codec.scene.sequence import open_sequence as open_sequence
    from airgs_codec.trainer import train as train
    from airgs_codec.trainer.settings import TrainSettings as TrainSettings

    Sequence = GaussianSequence

__version__ = "0.1.0"

_HOMES = {
    "decoder.decode": ("decode", "decode_frames"),
    "encoder.decide": ("decide",),
    "encoder.plan": ("Plan",),
    "encoder.publish": ("encode",),
    "encoder.settings": ("EncodeSettings",),
    "encoder.target": ("Goal",),
    "errors": ("AirgsError",),
    "inspect.compare": ("compare",),
    "inspect.errors": ("input_rows",),
    "inspect.validate": ("validate",),
    "package.package": ("Package", "open_package"),
    "play.ladder": ("Decision",),
    "play.playout": ("SessionSettings",),
    "play.policies": ("PlayerState",),
    "play.session": ("simulate",),
    "play.trace": ("Trace",),
    "render.backend": ("draw",),
    "scene.camera": ("Camera",),
    "scene.formats.table": ("read", "write"),
    "scene.gaussians": ("Gaussians",),
    "scene.sequence": ("GaussianSequence", "open_sequence"),
    "trainer": ("train",),
    "trainer.settings": ("TrainSettings",),
}
_PLACES = {name: f"{__name__}.{module}:{name}" for module, names in _HOMES.items() for name in names}
_PLACES["Sequence"] = _PLACES.pop("GaussianSequence")
__all__ = sorted(_PLACES)


def __getattr__(name: str) -> Any:
    """Return the public name `name`, from the module that defines it (PEP 562)."""
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return globals().setdefault(name, resolve_name(_PLACES[name]))


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
