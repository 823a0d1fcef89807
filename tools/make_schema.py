"""Write manifests/airgs.schema.json from the dataclasses of airgs_codec.package.tables, which are the schema.

python tools/make_schema.py
"""

from __future__ import annotations

import dataclasses
import json
import typing
from pathlib import Path
from typing import Any

from airgs_codec.package.tables import VERSION, Manifest

SCHEMA = Path(__file__).parent.parent / "manifests" / "airgs.schema.json"
_PLAIN = {int: "integer", float: "number", str: "string"}


def schema_of(kind: Any) -> dict[str, Any]:
    """JSON Schema of an annotated type."""
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin is list:
        return {"type": "array", "items": schema_of(arguments[0])}
    if origin is dict:
        return {"type": "object", "additionalProperties": schema_of(arguments[1])}
    if dataclasses.is_dataclass(kind):
        hints = typing.get_type_hints(kind)
        properties = {name: schema_of(hint) for name, hint in hints.items()}
        return {
            "type": "object",
            "description": (kind.__doc__ or "").split("\n")[0],
            "properties": properties,
            "required": list(properties),
            "additionalProperties": False,
        }
    return {"type": _PLAIN[kind]}


def manifest_schema() -> dict[str, Any]:
    """The schema of airgs.json."""
    schema = schema_of(Manifest)
    schema["properties"]["version"] = {"const": VERSION}
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "airgs.json", **schema}


def main() -> None:
    """Write the file."""
    SCHEMA.write_text(json.dumps(manifest_schema(), indent=1) + "\n")


if __name__ == "__main__":
    main()
