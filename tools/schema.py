"""The JSON Schemas of airgs.json and of the other tables, made from the dataclasses of `tables` and their annotations.

python -m tools.schema

writes manifests/airgs.schema.json, which is committed; a test compares.
"""

from __future__ import annotations

import dataclasses
import json
import typing
from pathlib import Path
from typing import Annotated, Any

from airgs_codec.package.parse import as_required
from airgs_codec.package.tables import VERSION, Group, Length, OneOf, Pattern, Range, Root, Spans

FILE = Path(__file__).parents[1] / "manifests" / "airgs.schema.json"
_PLAIN = {bool: "boolean", int: "integer", float: "number", str: "string"}


def manifest_schema() -> dict[str, Any]:
    """The schema of airgs.json, and under $defs those of a group's table and of a page of the index.

    What ties one field to another it cannot say, and `parse` checks.
    """
    schema = _schema_of(Root)
    schema["properties"]["version"] = {"const": VERSION}
    others = {"group": _schema_of(Group), "page": _schema_of(Spans)}
    draft = "https://json-schema.org/draft/2020-12/schema"
    return {"$schema": draft, "title": "airgs.json", **schema, "$defs": others}


def _schema_of(kind: Any) -> dict[str, Any]:
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin is Annotated:
        return _schema_of(arguments[0]) | {key: value for one in arguments[1:] for key, value in _keywords(one).items()}
    if origin is list:
        return {"type": "array", "items": _schema_of(arguments[0])}
    if origin is dict:
        names, values = (_schema_of(argument) for argument in arguments)
        return {"type": "object", "propertyNames": names, "additionalProperties": values}
    if dataclasses.is_dataclass(kind):
        return _schema_of_dataclass(kind)
    return {"type": _PLAIN[kind]}


def _keywords(constraint: Range | Length | OneOf | Pattern) -> dict[str, Any]:
    match constraint:
        case Range(low, high):
            return {"minimum": low, "maximum": high}
        case Length(low, high):
            return {"minItems": low, "maxItems": high}
        case OneOf(words):
            return {"enum": list(words)}
        case Pattern(expression):
            return {"pattern": f"^(?:{expression})$"}


def _schema_of_dataclass(kind: Any) -> dict[str, Any]:
    hints = typing.get_type_hints(kind, include_extras=True)
    properties = {name: _schema_of(as_required(hint)) for name, hint in hints.items()}
    return {
        "type": "object", "description": (kind.__doc__ or "").split("\n")[0], "properties": properties,
        "required": [name for name, hint in hints.items() if as_required(hint) is hint],
        "additionalProperties": False,
    }  # fmt: skip


def main() -> None:
    FILE.write_text(json.dumps(manifest_schema(), indent=1) + "\n")


if __name__ == "__main__":
    main()
