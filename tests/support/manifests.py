"""Small manifests with known sizes, for tests of the player."""

from __future__ import annotations

from collections.abc import Sequence

from airgs_codec.errors import FormatError
from airgs_codec.package import tables as mf
from tests.support.regions import region


def missing(*paths: str) -> dict[str, FormatError]:
    """Faults of a package without these files, as `find_faults` gives them."""
    return {path: FormatError("missing_file", path, "expected a file, got nothing") for path in paths}


HASH = mf.digest(b"")


def tiny_manifest(
    *,
    groups: Sequence[int] = (10, 10),
    fps: tuple[int, int] = (10, 1),
    key_bytes: Sequence[Sequence[int]] = ((3000, 1000), (1000, 500)),
    sidecar_bytes: int = 100,
    state_bytes: Sequence[int] = (2000, 1000, 500),
    init_bytes: int = 50,
    psnr: Sequence[Sequence[float]] | None = ((40.0, 36.0), (38.0, 35.0), (34.0, 32.0)),
) -> mf.Manifest:
    """One segment a group of `groups` frames; key_bytes[tier][quality], state_bytes[level], psnr[level][quality].

    A key unit has `sidecar_bytes` of sidecar and escapes, a state segment so many of escapes. A level of 0 bytes has
    nothing to fetch.
    """
    tiers, qualities, levels = len(key_bytes), len(key_bytes[0]), len(state_bytes)
    still, moving = (mf.Atlas(10, [0] * 13, [0], 16, 1, [0.1] * 5), mf.Atlas(10, [0] * 13, [0], 16, 1, [0.1] * 5))
    key = mf.Atlas(10, [0] * 10, [0], 16, 1, [0.1] * 4)
    picture = mf.Picture(64, 64, "avc1.64000A")
    spans = [(sum(groups[:i]), sum(groups[: i + 1])) for i in range(len(groups))]
    files: dict[str, int] = {}
    for t in range(tiers):
        for q in range(qualities):
            files[mf.key_init_path(t, q)] = init_bytes
            files |= {mf.key_media_path(t, q, g + 1): key_bytes[t][q] for g in range(len(groups))}
            files |= {mf.key_detail_path(t, q, g + 1): 10 for g in range(len(groups))}
        files |= {mf.key_sidecar_path(t, g + 1): sidecar_bytes - 10 for g in range(len(groups))}
    for j, size in enumerate(state_bytes):
        if size:
            files |= {mf.state_media_path(j, g + 1): size for g in range(len(groups))}
            files |= {mf.state_sidecar_path(j, g + 1): sidecar_bytes for g in range(len(groups))}
        files[mf.state_init_path(j)] = init_bytes
    return mf.Manifest(
        version=mf.VERSION,
        generator=mf.Generator("test", {}, {}),
        attribution="",
        repairs=[],
        decisions=[],
        frame_rate=list(fps),
        timescale=fps[0] * 100,
        frames=sum(groups),
        sh_degree=0,
        key_gain=3.0,
        state_gain=6.0,
        region=region(),
        views=mf.Views(24, 12 if psnr else 0, "original" if psnr else "none"),
        qualities=[mf.KeyQuality(f"Q{q}", 1.0 + 2 * q, q) for q in range(qualities)],
        levels=[mf.Level(f"L{j}", 0.1 * j, 1.0 + j, tiers, 0) for j in range(levels)],
        key_pictures=[[picture] * qualities for _ in range(tiers)],
        state_pictures=[picture] * levels,
        groups=[
            mf.Group(
                start=start,
                stop=stop,
                count=10 * tiers,
                static=0,
                unused=0,
                grid=mf.Grid([0.0, 0.0, 0.0], 0.01, 8, 0),
                key_steps=mf.KeySteps(0.1, 0.1, 0.1, 0.1, 0.1),
                state_steps=mf.StateSteps(0.1, 0.1, 0.1, 0.1, 0.1, 0.1),
                colour_transform="",
                tiers=[mf.GroupTier(10, g + 1, [key] * qualities) for _ in range(tiers)],
                levels=[moving if size else still for size in state_bytes],
            )
            for g, (start, stop) in enumerate(spans)
        ],
        segments=[
            mf.Segment(
                group=g,
                start=start,
                stop=stop,
                levels=[
                    mf.SegmentLevel(
                        g + 1 if size else 0,
                        [size // (stop - start)] * (stop - start) if size else [],
                        list(psnr[j]) if psnr else [],
                        [value - 2 for value in psnr[j]] if psnr else [],
                        [0.9] * qualities if psnr else [],
                        [0.5 + j] * qualities if psnr else [],
                    )
                    for j, size in enumerate(state_bytes)
                ],
            )
            for g, (start, stop) in enumerate(spans)
        ],
        left_out=[],
        files={path: mf.FileEntry(size, HASH) for path, size in files.items()},
    )
