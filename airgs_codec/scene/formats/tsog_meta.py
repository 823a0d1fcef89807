"""What the meta.json of TSOG may say (TSOG-SPEC.md, sections 1 to 9): everything is looked at before a picture is."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from airgs_codec.scene.formats.sog import META_NAME, Meta

VERSION = 4
PROFILE = {"id": "org.opsiclear.tsog-playback", "version": 1}
MOST_DISCRETE = 1 << 16  # frames
LAST_CODE = 65535  # of 16 bits
_FLOAT32 = float(np.finfo(np.float32).max)
_SAFE = 2**53 - 1
_SOUNDS = {"mp3", "m4a", "aac", "ogg", "oga", "opus", "wav", "flac", "webm"}  # endings whose kind is known
_MIME = re.compile(r"audio/[a-z0-9.+-]+", re.ASCII | re.IGNORECASE)
_BAD_NAME = re.compile(r"[\x00-\x1f\\:?#]")
_LEVELS = 256


def check_meta(meta: Any) -> None:
    """Raises ValueError, TypeError or LookupError for metadata that a reader must not guess at."""
    _object(meta, META_NAME)
    if meta.get("version") != VERSION or ("profile" in meta and not _is_profile(meta["profile"])):
        profile = meta.get("profile", {})
        raise ValueError(
            f"expected version {VERSION} and profile {PROFILE}, got {meta.get('version')!r} and {profile!r}"
        )
    meta["count"] = _integer(meta["count"], 1, _SAFE, "count")
    _range(meta["means"], 3, "means")
    for part in ("scales", "sh0"):
        _book(meta[part], part)
    if "shN" in meta:
        _book(meta["shN"], "shN")
        meta["shN"]["bands"] = _integer(meta["shN"]["bands"], 1, 3, "bands")
        meta["shN"]["count"] = _integer(meta["shN"]["count"], 1, 1 << 16, "count of shN")
    if "timeline" in meta:
        _check_timeline(_object(meta["timeline"], "timeline"))
    if "temporal" in meta:
        if "timeline" not in meta or set(_object(meta["temporal"], "temporal")) != {"means"}:
            raise ValueError("expected a timeline and positions alone in temporal")
        _check_motion(_object(meta["temporal"]["means"], "temporal.means"))
    names = image_names(meta)
    _check_playback(meta)
    if "audio" in meta:
        _check_audio(
            _object(meta["audio"], "audio"), names, "timeline" in meta or "duration" in meta.get("playback", {})
        )


def image_names(meta: Meta) -> list[str]:
    """All pictures, each once. Raises ValueError for names that are none."""
    found: list[str] = []
    parts = [(part, meta[part], [number]) for part, number in (("means", 2), ("scales", 1), ("quats", 1), ("sh0", 1))]
    parts += [("shN", meta["shN"], [2])] if "shN" in meta else []
    parts += [("timeline", meta["timeline"], [2])] if "timeline" in meta else []
    parts += [("temporal.means", meta["temporal"]["means"], [1, 2])] if "temporal" in meta else []
    for part, group, numbers in parts:
        names = _object(group, part)["files"]
        if (
            not isinstance(names, list)
            or len(names) not in numbers
            or len({_name(name) for name in names}) < len(names)
        ):
            raise ValueError(f"{part}: expected {numbers[-1]} names of files")
        found += names
    if META_NAME in found:
        raise ValueError(f"expected pictures, got {META_NAME}")
    return list(dict.fromkeys(found))


def _is_profile(value: Any) -> bool:
    named = _object(value, "profile")
    return (
        named.get("id") == PROFILE["id"] and _integer(named.get("version"), 0, _SAFE, "profile") == PROFILE["version"]
    )


def _check_timeline(line: Meta) -> None:
    kind = _integer(line["type"], 0, 1, "type of the timeline")
    line["type"] = kind
    if kind == 0:
        line["N"] = _integer(line["N"], 1, MOST_DISCRETE, "N")
        step = (1 << 16) // line["N"]
        line["delta"] = _integer(line["delta"], step, step, "delta")
    else:
        _range(line, 2, "timeline")
        if not np.float32(line["mins"][1]) > 0:
            raise ValueError("expected standard deviations above 0 in the timeline")


def _check_motion(part: Meta) -> None:
    rows = [part[name] for name in ("mins", "maxs")]
    if not all(isinstance(row, list) and len(row) == 1 for row in rows):
        raise ValueError("temporal.means: expected motion of the first order")
    _range({"mins": rows[0][0], "maxs": rows[1][0]}, 3, "temporal.means")


def _check_playback(meta: Meta) -> None:
    playback = _object(meta.get("playback", {}), "playback")
    for where, name in ((meta, "fps"), (playback, "fps"), (playback, "duration")):
        if name in where and _number(where[name], name) <= 0:
            raise ValueError(f"expected {name} above 0")
    if "rate" in playback and not 0.25 <= _number(playback["rate"], "rate") <= 4:
        raise ValueError("expected a rate of 0.25 to 4")
    if not isinstance(playback.get("loop", True), bool):
        raise ValueError("expected loop to be true or false")
    if meta.get("timeline", {}).get("type") == 0 and {"duration", "fps"} <= playback.keys():
        frames = meta["timeline"]["N"]
        if abs(playback["duration"] * playback["fps"] - frames) > 1e-6 * frames:
            raise ValueError(f"expected duration x fps to be {frames} frames")


def _check_audio(audio: Meta, pictures: Sequence[str], timed: bool) -> None:
    name = _name(audio["file"])
    ending = name.rsplit(".", 1)[-1].lower() if "." in name else ""
    kind = audio.get("mimeType", f"audio/{ending}" if ending in _SOUNDS else "")
    if not isinstance(kind, str) or not _MIME.fullmatch(kind):
        raise ValueError("audio: expected a kind of sound")
    if name == META_NAME or name in pictures:
        raise ValueError("audio: expected a file of its own")
    if "volume" in audio and not 0 <= _number(audio["volume"], "volume") <= 1:
        raise ValueError("audio: expected a volume of 0 to 1")
    if not timed:
        raise ValueError("audio: expected a duration, for the scene is still")


def _object(value: Any, what: str) -> Meta:
    if not isinstance(value, dict):
        raise ValueError(f"{what}: expected an object, got {value!r:.40}")
    return value


def _number(value: Any, what: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{what}: expected a number, got {value!r:.40}")
    return value


def _integer(value: Any, low: int, high: int, what: str) -> int:
    number = _number(value, what)
    if number != int(number) or not low <= number <= high:
        raise ValueError(f"{what}: expected a whole number of {low} to {high}, got {value!r:.40}")
    return int(number)


def _numbers(values: Any, least: int, most: int, what: str) -> None:
    if not isinstance(values, list) or not least <= len(values) <= most:
        raise ValueError(f"{what}: expected {most} numbers")
    if any(abs(_number(value, what)) > _FLOAT32 for value in values):
        raise ValueError(f"{what}: expected numbers of float32")


def _book(part: Any, what: str) -> None:
    _numbers(_object(part, what)["codebook"], 1, _LEVELS, f"codebook of {what}")


def _range(part: Any, count: int, what: str) -> None:
    """Raises ValueError unless no least value of so many is above the largest."""
    low, high = _object(part, what)["mins"], part["maxs"]
    for values in (low, high):
        _numbers(values, count, count, what)
    if any(a > b for a, b in zip(low, high, strict=True)):
        raise ValueError(f"{what}: expected mins that are at most maxs")


def _name(value: Any) -> str:
    if not isinstance(value, str) or _BAD_NAME.search(value) or not {"", ".", ".."}.isdisjoint(value.split("/")):
        raise ValueError(f"expected the name of a file within the archive, got {value!r:.40}")
    return value
