"""Write the conformance corpus: manifests/valid/<name>/ and manifests/invalid/<reason>/, small whole packages.

    python tools/make_conformance.py

Every package under invalid/ is valid/moving with one thing broken, and must be refused for the reason it is named
after. Encoder bytes may change from one x264 to the next; what the packages decode to is pinned in tests/golden.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from airgs_codec.coding.sidecar import pack_key_sidecar, unpack_key_sidecar
from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.package.store import open_package
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.ply import write_ply
from airgs_codec.scene.sequence import open_sequence

CORPUS = Path(__file__).parent.parent / "manifests"
KEY_SIDECAR, KEY_PICTURE, STATE_SIDECAR = "key/T0/1.bin", "key/T0/Q0/1.m4s", "state/L0/1.bin"
Break = Callable[[Path, dict[str, Any]], dict[str, Any] | str | None]


def frames(count: int, degree: int, length: int) -> list[Gaussians]:
    """A small ball of Gaussians, half of it swinging."""
    rng = np.random.default_rng(7)
    rest = rng.normal(size=(count, {0: 0, 1: 3}[degree], 3)) * 0.2
    still = rng.normal(size=(count, 3)) * 0.4
    columns = [rng.normal(size=(count, 4)), rng.normal(size=(count, 3)) * 0.3 - 2, rng.normal(size=count) * 2]
    columns += [rng.normal(size=(count, 3)), rest]
    swing = (np.arange(count) % 2)[:, None] * np.array([0.2, 0.05, 0.0])
    moved = [still + swing * np.sin(0.5 * t) for t in range(length)]
    return [Gaussians(*(np.asarray(c, np.float32) for c in (means, *columns))) for means in moved]


VALID = {
    "moving": (frames(64, 0, 4), EncodeSettings(calibrate="none", levels=((0.0, 1.0), (0.5, 2.0)))),
    "one-gaussian": (frames(1, 1, 1), EncodeSettings(calibrate="none", levels=((0.0, 1.0),), key_factors=(1.0,))),
    "two-groups-sh1": (
        frames(40, 1, 5),
        EncodeSettings(calibrate="none", levels=((0.0, 1.0),), group_frames=3, segment_s=0.07),
    ),
}


def drop(name: str) -> Break:
    """Remove a field of the tables."""
    return lambda _, data: {k: v for k, v in data.items() if k != name}


def change(**fields: Any) -> Break:
    """Set fields of the tables."""
    return lambda _, data: data | fields


def edit_mpd(old: str, new: str) -> Break:
    """Replace text in manifest.mpd."""

    def apply(folder: Path, data: dict[str, Any]) -> None:
        path = folder / "manifest.mpd"
        text = path.read_text()
        if old not in text:
            raise ValueError(f"{old!r} is not in the MPD")
        path.write_text(text.replace(old, new, 1))

    return apply


def rewrite(relative: str, make: Callable[[bytes], bytes], honest: bool = True) -> Break:
    """Replace a file; `honest`: its entry is made to agree."""

    def apply(folder: Path, data: dict[str, Any]) -> dict[str, Any]:
        content = make((folder / relative).read_bytes())
        (folder / relative).write_bytes(content)
        if honest:
            data["files"][relative] = {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}
        return data

    return apply


def without_moving_rows(folder: Path, data: dict[str, Any]) -> dict[str, Any]:
    """Say in a sidecar that its rows are static, while the tables count them."""
    package = open_package(folder)
    group = package.manifest.groups[0]
    sidecar = unpack_key_sidecar(package.read(KEY_SIDECAR), group.tiers[0].count, group.grid, KEY_SIDECAR)
    still = replace(sidecar, depths=np.full_like(sidecar.depths, 255))
    return rewrite(KEY_SIDECAR, lambda _: pack_key_sidecar(still, group.grid))(folder, data)  # type: ignore[return-value]


def rename_entry(folder: Path, data: dict[str, Any]) -> dict[str, Any]:
    """An entry that leads out of the package."""
    return data | {"files": data["files"] | {"../outside.bin": data["files"][KEY_SIDECAR]}}


def forget_entry(folder: Path, data: dict[str, Any]) -> dict[str, Any]:
    """A file that the tables need and do not list."""
    return data | {"files": {k: v for k, v in data["files"].items() if k != STATE_SIDECAR}}


def remove_file(folder: Path, data: dict[str, Any]) -> None:
    """A listed file that is not there."""
    (folder / KEY_PICTURE).unlink()


def add_file(folder: Path, data: dict[str, Any]) -> None:
    """A file that no table lists."""
    (folder / "notes.txt").write_text("not part of the package\n")


def flip(data: bytes) -> bytes:
    """Change the last byte."""
    return data[:-1] + bytes([data[-1] ^ 1])


INVALID: dict[str, Break] = {
    "not_json": lambda _, data: json.dumps(data)[:-1],
    "unknown_version": change(version=2),
    "unknown_field": change(colour="red"),
    "missing_field": drop("frames"),
    "wrong_type": change(frames="4"),
    "bad_value": change(sh_degree=4),
    "unsafe_path": rename_entry,
    "missing_entry": forget_entry,
    "missing_file": remove_file,
    "foreign_file": add_file,
    "size_mismatch": rewrite(KEY_SIDECAR, lambda b: b + b"\0", honest=False),
    "hash_mismatch": rewrite(KEY_SIDECAR, flip, honest=False),
    "bad_sidecar": rewrite(KEY_SIDECAR, lambda b: b[: len(b) // 2]),
    "count_mismatch": without_moving_rows,
    "bad_picture": rewrite(KEY_PICTURE, lambda b: b[:-40] + bytes(40)[:20]),
    "doctype": edit_mpd("<MPD", '<!DOCTYPE MPD [<!ENTITY a "b">]><MPD'),
    "bad_mpd": edit_mpd("</MPD>", ""),
    "foreign_url": edit_mpd('media="state/', 'media="http://example.com/state/'),
    "mpd_mismatch": edit_mpd('<S t="0"', '<S t="1"'),
}


def main() -> None:
    """Write the corpus anew."""
    for part in ("valid", "invalid"):
        shutil.rmtree(CORPUS / part, ignore_errors=True)
    for name, (sequence, settings) in VALID.items():
        with tempfile.TemporaryDirectory() as folder:
            for i, frame in enumerate(sequence):
                write_ply(Path(folder) / f"{i:06d}.ply", frame)
            encode(open_sequence(Path(folder)), CORPUS / "valid" / name, settings)
    for reason, apply in INVALID.items():
        target = CORPUS / "invalid" / reason
        shutil.copytree(CORPUS / "valid" / "moving", target)
        tables = target / "airgs.json"
        changed = apply(target, json.loads(tables.read_text()))
        if changed is not None:
            tables.write_text(changed if isinstance(changed, str) else json.dumps(changed, separators=(",", ":")))


if __name__ == "__main__":
    main()
