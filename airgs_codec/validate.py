"""Is a package whole and does it decode? Findings instead of exceptions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from airgs_codec.decode import decode_canonical, decode_segment
from airgs_codec.errors import FormatError
from airgs_codec.manifest import JSON_NAME, MPD_NAME, expected_files
from airgs_codec.mpd import check_mpd
from airgs_codec.package import Package, open_package


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is wrong; `reason` is a word of FORMAT.md's table of refusals."""

    reason: str
    where: str
    detail: str

    def __str__(self) -> str:
        return f"{self.where}: {self.detail} [{self.reason}]"


def validate(path: Path) -> list[Finding]:
    """Everything that is wrong with the package in folder `path`; empty for a good one.

    Checks the tables, the MPD against them, every file's length and digest, foreign files, and that every key unit
    and every segment of every level decodes to the promised pictures.
    """
    try:
        package = open_package(path)
    except FormatError as error:
        return [_finding(error)]
    findings = list(_check_files(package))
    try:
        check_mpd((path / MPD_NAME).read_bytes(), package.manifest)
    except FormatError as error:
        findings.append(_finding(error))
    if not findings:  # broken files would only repeat themselves
        findings = list(_check_decoding(package))
    return findings


def _finding(error: FormatError) -> Finding:
    return Finding(error.reason, error.where, error.detail)


def _check_files(package: Package) -> Iterator[Finding]:
    listed = set(package.manifest.files)
    for relative in sorted(listed):
        try:
            package.read(relative)
        except FormatError as error:
            yield _finding(error)
    for relative in sorted(listed - set(expected_files(package.manifest))):
        yield Finding("foreign_file", relative, "listed, but no table refers to it")
    for file in sorted(package.path.rglob("*")):
        relative = file.relative_to(package.path).as_posix()
        if file.is_symlink():
            yield Finding("unsafe_path", relative, "expected plain files and folders, got a link")
        elif file.is_file() and relative not in listed | {JSON_NAME, MPD_NAME}:
            yield Finding("foreign_file", relative, f"not listed in {JSON_NAME}")


def _check_decoding(package: Package) -> Iterator[Finding]:
    m = package.manifest
    for g in range(len(m.groups)):
        for q in range(len(m.qualities)):
            try:
                base = decode_canonical(package, g, q)
                if q == 0:
                    for s, segment in enumerate(m.segments):
                        for j in range(len(m.levels) if segment.group == g else 0):
                            for _ in decode_segment(package, s, base, j, 0, segment.stop - segment.start):
                                pass
            except FormatError as error:
                yield _finding(error)
