"""What the browser player in web/src knows from Python: constants, and the schema of the tables of a package.

python -m tools.typescript

writes web/src/generated/, which is committed, so that a clone builds the player without Python; a test compares. What
a constant means, and why it has its value, stands where it belongs in airgs_codec; here it has the name that TypeScript
imports. What only one side has, such as the sizes of its caches, is not here.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from airgs_codec.coding import atlas, channels, escapes, rangecoder
from airgs_codec.media import h264, metrics, mp4
from airgs_codec.package import layout, parse, region, tables
from airgs_codec.play import downloader, http, ladder, offers, player, policies
from airgs_codec.play.playout import SessionSettings
from airgs_codec.render import cpu, cpu_kernels
from airgs_codec.scene import gaussians
from tools.schema import manifest_schema

FOLDER = Path(__file__).parents[1] / "web" / "src" / "generated"
_FLAGS = {
    "trun": {"offset": mp4.DATA_OFFSET, "first": mp4.FIRST_SAMPLE_FLAGS, "duration": mp4.DURATION, "size": mp4.SIZE}
    | {"composition": mp4.COMPOSITION_OFFSET},
    "tfhd": {"base": mp4.BASE_DATA_OFFSET, "description": mp4.DESCRIPTION_INDEX}
    | {"duration": mp4.DEFAULT_DURATION, "size": mp4.DEFAULT_SIZE},
}
MADE = "// Made by python -m tools.typescript from airgs_codec"
SETTINGS = ("buffer_s", "startup_s", "resume_s", "decode_frame_s", "replace", "abandon")


def main() -> None:
    FOLDER.mkdir(exist_ok=True)
    for name, text in files().items():
        (FOLDER / name).write_text(text, encoding="utf-8")


def files() -> dict[str, str]:
    return {"constants.ts": _constants_file(), "schema.ts": _schema_file()}


def constants() -> dict[ModuleType, dict[str, Any]]:
    """The name and the value of each constant in TypeScript, by the module that has it."""
    return {
        tables: _same(tables, "VERSION", "PAGE", "DIGEST", "BLOCK", "STATIC", "LEAST_CLASS", "MOST_CLASS", "MOST_WIDER")
        | _same(tables, "TRANSFORM_UNITS")
        | {
            "LIMITS": {"bits": tables.GRID_BITS, "side": tables.MAX_PICTURE_SIDE, "macroblocks": tables.MAX_MACROBLOCKS}
            | {"pages": tables.MAX_PAGES}
        }
        | _same(tables, "MIN_PICTURE_SIDE", "MAX_POSTER_BYTES", "PACKETS"),
        parse: _same(parse, "MAX_TABLE_BYTES", "MAX_VALUES"),
        layout: {"ROOT_PATH": layout.JSON_NAME, "INIT_PATH": layout.INIT_NAME, "POSTER_PATH": layout.POSTER_NAME}
        | {"SOUND_INIT_PATH": layout.SOUND_INIT_NAME}
        | {"PATHS": [[f"^{pattern}$", what] for pattern, what in layout.PATTERNS.items()]}
        | _channels(layout.KEYFRAME)
        | _channels(layout.DELTA),
        region: _same(region, "LEAST_SCALE", "MOST_SCALE")
        | {"WORLD_TOLERANCE": parse.TOLERANCE}
        | _same(region, "AGREEMENT", "LEVELLING", "FORGIVEN_DEGREES", "FORGIVEN_SHARE"),
        gaussians: _same(gaussians, "SMALL_ANGLE", "SH_C0"),
        atlas: _same(atlas, "GREY"),
        channels: _same(channels, "OPACITY_MARGIN"),
        escapes: {"ESCAPE_UNIT": escapes.UNIT},
        rangecoder: _same(rangecoder, "RANGE_START", "RANGE_LEAST", "CHANCE_HALF", "CHANCE_LEAST", "END_BYTES")
        | _same(rangecoder, "MODEL_MEMORY", "MODEL_CONTEXTS", "LENGTH_BITS", "MODELLED_BITS"),
        mp4: {"BOX_HEADER": mp4.HEADER, "OWN_UUID": mp4.OWN_UUID.hex()}
        | {"TRUN": _FLAGS["trun"], "TFHD": _FLAGS["tfhd"]}
        | _same(mp4, "PACKET_TICKS", "SOUND_RATE", "WARM_UP"),
        h264: _same(h264, "DARKEST", "BRIGHTEST"),
        metrics: _same(metrics, "PSNR_CAP"),
        cpu: {"FAR": cpu.FAR_PLANE} | _same(cpu, "DILATION"),
        cpu_kernels: {"MARGIN": cpu_kernels.LINEAR_MARGIN} | _same(cpu_kernels, "ALPHA_MAX", "SH_C1", "SH_C2", "SH_C3"),
        **_of_players(),
    }


def _of_players() -> dict[ModuleType, dict[str, Any]]:
    settings, patience = SessionSettings(), http.HttpSettings()
    return {
        policies: _same(policies, "DEFAULT_POLICY", "SAFETY", "HALF_LIVES_S", "BUFFER_SHARE", "RESERVE_S", "STALL_DB")
        | _same(policies, "SWITCH_DB", "LOW_BUFFER_DB", "HORIZON_S", "HORIZON_SEGMENTS", "GRID_POINTS")
        | _same(policies, "PAST_DOWNLOADS") | {"POLICY_NAMES": list(policies.ADAPTIVE)},
        ladder: _same(ladder, "DEFAULT_BETA", "EPS_DB", "CLIFF_DB"),
        offers: _same(offers, "HEADER_BYTES", "OVER_BUDGET"), downloader: _same(downloader, "CHECK_S"),
        player: _same(player, "REMEMBERED", "SHORTEST_S", "LONGEST_POLL_S", "POLL_S")
        | {"SILENCE_S": player.GONE_S, "REPLACE_GAIN_DB": player.REPLACE_GAIN_DB}
        | {"SESSION": {_camel(name): getattr(settings, name) for name in SETTINGS}},
        http: _same(http, "BUSY", "GARBLED", "LONGEST_PAUSE_S", "LEAST_BYTES")
        | {"TIMEOUT_S": patience.timeout_s, "ATTEMPTS": patience.attempts, "BACKOFF_S": patience.backoff_s},
    }  # fmt: skip


def _same(module: ModuleType, *names: str) -> dict[str, Any]:
    return {name: getattr(module, name) for name in names}


def _camel(name: str) -> str:
    return re.sub("_(.)", lambda match: match[1].upper(), name)


def _channels(kind: layout.Layout) -> dict[str, Any]:
    """Attributes in order, where the channels of each begin, and the attribute of each channel before colour."""
    values = {
        "ATTRIBUTES": kind.attributes,
        "AT": {name: kind.slice(name).start for name in kind.attributes},
        "CHANNELS": kind.names(0),
    }
    return {f"{kind.kind.upper()}_{name}": value for name, value in values.items()}


def _constants_file() -> str:
    parts = [f"{MADE}: the modules named below say what each is.\n"]
    seen: set[str] = set()
    for module, values in constants().items():
        assert seen.isdisjoint(values), f"{module.__name__}: {seen & set(values)} stand there already"
        seen |= set(values)
        lines = [f"export const {name}{_declared(value)};\n" for name, value in values.items()]
        parts.append(f"\n// {module.__name__}\n{''.join(lines)}")
    return "".join(parts)


def _declared(value: Any) -> str:
    """The rest of a declaration, from its colon on. Lists of numbers may have any number, others are as they are."""
    if isinstance(value, list | tuple) and all(isinstance(item, int | float) for item in value):
        return f": readonly number[] = {json.dumps(value)}"
    if isinstance(value, dict | list | tuple):
        return f" = {json.dumps(value)} as const"
    return f" = {float(value)!r}" if isinstance(value, float | np.floating) else f" = {json.dumps(value)}"


def _schema_file() -> str:
    """The schemas of the tables, shortened to what the player checks and has its types from.

    They are JSON Schema without words for people, but that an object which names its `properties` has no others and
    lists those that may be absent, `optional`, that what numbers and lengths of arrays may be is a `range`, and that
    `items` and `additionalProperties` say what has them.
    """
    schema = manifest_schema()
    kinds = {"root": {name: value for name, value in schema.items() if name != "$defs"}, **schema["$defs"]}
    lines = [f"export const {name} = {json.dumps(_bare(kind))} as const;\n" for name, kind in kinds.items()]
    return f"{MADE}.package.tables.\n" + "".join(lines)


def _bare(node: Any, of_properties: bool = False) -> Any:
    """A schema without titles and descriptions; properties of a table may have such names, which stay."""
    if isinstance(node, list):
        return [_bare(item) for item in node]
    if not isinstance(node, dict):
        return node
    words = () if of_properties else ("title", "description", "$schema")
    bare = {
        name: _bare(value, not of_properties and name == "properties")
        for name, value in node.items()
        if name not in words
    }
    if of_properties:
        return bare
    for bounds in (("minimum", "maximum"), ("minItems", "maxItems")):
        if bounds[0] in bare:
            bare["range"] = [bare.pop(bound) for bound in bounds]
    if "properties" not in node:
        if "items" in bare or "additionalProperties" in bare:
            bare = {name: value for name, value in bare.items() if name not in ("type", "propertyNames")}
        return bare
    assert bare.pop("type") == "object" and bare.pop("additionalProperties") is False
    required = bare.pop("required")
    optional = [name for name in bare["properties"] if name not in required]
    return bare | ({"optional": optional} if optional else {})


if __name__ == "__main__":
    main()
