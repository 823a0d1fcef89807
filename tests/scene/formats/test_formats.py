"""Every format: what the libraries write is read back, what is broken is refused in a line, nothing takes memory."""

import gzip
import importlib.util
import io
import json
import struct
import subprocess
import sys
import zipfile

import numpy as np
import pytest

from tests import faces
from tests.faces import SceneError, format_of, read_frame, read_frame_header, sigmoid
from tests.support.camera_files import saved
from tests.support.effort import few_calls
from tests.support.mutations import edit_tables
from tests.support.scenes import random_gaussians
from tests.support.splat_files import SUFFIXES, glb_bytes, splat_bytes, write_sog_v1

TOLERANCE = {  # of means, log-scales, alpha, colour and SH, 12 bits and 8 at best
    ".compressed.ply": (3e-3, 5e-3, 3e-3, 3e-2, 0.05), ".sog": (3e-4, 0.1, 3e-3, 0.15, 0.5),
    ".splat": (1e-6, 1e-5, 4e-3, 0.02, 0), ".glb": (1e-6, 1e-5, 1e-5, 1e-6, 1e-6),
}  # fmt: skip

SPZ = (2e-4, 0.04, 3e-3, 0.02, 0.07)
SPZ_HEAD = "<4sIIBBBB"

LIMITS = {  # of logits of alpha 0 and 1, and the thinnest axis, for forms that have no zero
    ".ply": (20, None), ".compressed.ply": (6.93, -20), **dict.fromkeys((".v2.spz", ".v3.spz", ".v4.spz"), (6.93, -10)),
}  # fmt: skip


def copied(g):
    return faces.Gaussians(*(getattr(g, name).copy() for name in g.__slots__))


def small(count=700, degree=2):
    """Colours that every format can hold, means that no two share."""
    g = random_gaussians(count, degree)
    unit = g.quaternions / np.linalg.norm(g.quaternions, axis=1, keepdims=True)  # as some writers expect them
    return faces.Gaussians(g.means, unit, g.log_scales, g.opacity_logits, np.clip(g.sh_dc, -1.7, 1.7), g.sh_rest)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_what_was_written_is_read_back_with_all_its_harmonics_and_forms_are_told_apart(tmp_path, suffix):
    g, most = small(), 0 if suffix == ".splat" else 3
    path = saved(tmp_path / f"a{suffix}", splat_bytes(g, suffix))
    header, back, degree = read_frame_header(path), read_frame(path), min(2, most)
    assert (header.count, header.sh_degree, len(back), back.sh_degree) == (700, degree, 700, degree)
    nearest = ((g.means[None] - back.means[:, None]) ** 2).sum(axis=2).argmin(axis=1)
    assert len(set(nearest.tolist())) == 700
    g = g.take(nearest).with_degree(degree)
    means, scales, alpha, colour, harmonics = TOLERANCE.get(suffix, SPZ)
    np.testing.assert_allclose(back.means, g.means, atol=means)
    np.testing.assert_allclose(back.log_scales, g.log_scales, atol=scales)
    np.testing.assert_allclose(sigmoid(back.opacity_logits), sigmoid(g.opacity_logits), atol=alpha)
    np.testing.assert_allclose(back.sh_dc, g.sh_dc, atol=colour)
    np.testing.assert_allclose(back.sh_rest, g.sh_rest, atol=harmonics)
    a, b = (q / np.linalg.norm(q, axis=1, keepdims=True) for q in (back.quaternions, g.quaternions))
    assert np.abs((a * b).sum(axis=1)).min() > 0.995
    assert all(getattr(back, n).dtype == np.float32 for n in back.__slots__)
    for degree in (0, 1, 3):
        path = saved(tmp_path / f"b{suffix}", splat_bytes(small(300, degree), suffix))
        assert read_frame(path).sh_degree == read_frame_header(path).sh_degree == min(degree, most)
    name = format_of(path).name
    assert name == {".compressed.ply": "compressed .ply", ".sog": "SOG"}.get(suffix, name)


@pytest.mark.parametrize("form", [".ply", *SUFFIXES])
def test_the_same_values_mean_the_same_in_every_form(tmp_path, form):
    """Row 1 is flat, 2 is gone, 3 is opaque, 4 has no rotation, 5 is nowhere; rotations are told apart by their order.

    SOG has none of these but alpha: its writer makes no file of them.
    """
    g, path = copied(small(300, 0)), tmp_path / f"a{form}"
    g.means[:, 0] = np.arange(300) / 10
    g.opacity_logits[2:4] = (-40, 40) if form == ".sog" else (-np.inf, np.inf)
    if form != ".sog":
        g.log_scales[1, 0] = -np.inf
    if form in (".ply", ".splat"):  # others hold no such rows
        g.quaternions[4], g.means[5, 1] = 0, np.nan
    faces.write_ply(path, g) if form == ".ply" else path.write_bytes(splat_bytes(g, form))
    back = read_frame(path)
    done = faces.repair([back.take(np.argsort(back.means[:, 0]))], "a")
    shown, (most, thin) = done.frames[0], LIMITS.get(form, (6.93, None))
    assert -most - 0.01 <= shown.opacity_logits[2] < -5.5 and 5.5 < shown.opacity_logits[3] <= most + 0.01
    if form != ".sog":
        assert shown.log_scales[1, 0] == pytest.approx(thin or g.log_scales[1].max() + np.log(1e-3), abs=0.1)
    turns = np.abs((shown.quaternions * g.quaternions).sum(axis=1))
    assert np.delete(turns, [4, 5]).min() > 0.995
    if form in (".ply", ".splat"):
        assert abs(shown.quaternions[4, 0]) == 1 and shown.opacity_logits[5] == -20
        assert "1 Gaussians that are not finite" in done.notes[0] and "without thickness" in done.notes[-1]


def test_opacities_of_0_and_1_are_finite_and_none_is_made_up(tmp_path):
    g = copied(small(4, 0))
    g.opacity_logits[:] = -np.inf, np.inf, 0, np.nan
    found = read_frame(saved(tmp_path / "a.glb", glb_bytes(g))).opacity_logits
    np.testing.assert_array_equal(found, np.float32([-np.log(1019), np.log(1019), 0, np.nan]))


def test_a_splat_row_is_pinned(tmp_path):
    row = struct.pack("<6f8B", 1, 2, 3, -1, 0, np.e, 255, 0, 51, 255, 255, 128, 128, 0)
    g = read_frame(saved(tmp_path / "a.splat", row))
    assert g.means.tolist() == [[1, 2, 3]] and g.quaternions.tolist() == [[127 / 128, 0, 0, -1]]
    np.testing.assert_allclose(g.log_scales[0], [np.nan, -np.inf, 1], atol=1e-6)
    np.testing.assert_allclose(g.sh_dc[0] * faces.SH_C0 + 0.5, [1, 0, 0.2], atol=1e-6)


def test_a_node_moves_turns_and_scales_its_splats(tmp_path):
    g, half = small(50, 0), float(np.sqrt(0.5))
    data = glb_bytes(g, translation=[1, 2, 3], rotation=[0, 0, half, half], scale=[2, 2, 2])
    back = read_frame(saved(tmp_path / "a.glb", data))
    turned = np.stack([-g.means[:, 1], g.means[:, 0], g.means[:, 2]], axis=1)
    np.testing.assert_allclose(back.means, 2 * turned + [1, 2, 3], atol=1e-5)
    np.testing.assert_allclose(back.log_scales, g.log_scales + np.log(2), atol=1e-5)
    for change, says in (({"scale": [1, 2, 1]}, "evenly"), ({"rotation": [0, 0, 1, 0]}, "turns them")):
        with pytest.raises(SceneError, match=says):
            read_frame_header(saved(tmp_path / "b.glb", glb_bytes(small(5, 1), **change)))


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_sog_of_version_1_is_read_as_a_folder_and_as_an_archive(tmp_path, degree):
    g = small(300, degree)
    folder = write_sog_v1(tmp_path / "a", g)
    archive = saved(tmp_path / "a.sog", zipped({path.name: path.read_bytes() for path in folder.iterdir()}))
    back, header = read_frame(folder), read_frame_header(folder)
    assert (header.count, header.sh_degree, back.sh_degree) == (300, degree, degree)
    logs = np.sign(g.means) * np.log1p(np.abs(g.means))
    assert (np.abs(back.means - g.means) <= np.exp(np.abs(logs)) * np.ptp(logs, axis=0) / 65535).all()
    for name in ("log_scales", "sh_dc", "opacity_logits"):
        step = np.ptp(getattr(g, name), axis=0) / 255
        assert (np.abs(getattr(back, name) - getattr(g, name)) <= step / 2 + 1e-5).all()
    assert np.abs(back.sh_rest - g.sh_rest).max(initial=0) <= np.ptp(g.sh_rest) / 510 + 1e-5 if degree else True
    assert np.abs((back.quaternions * g.quaternions).sum(axis=1)).min() > 0.9999
    for name in back.__slots__:
        np.testing.assert_array_equal(getattr(read_frame(archive), name), getattr(back, name))


def unzipped(data):
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def zipped(files, method=zipfile.ZIP_STORED):
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", method) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return out.getvalue()


BROKEN_SOG = [
    (2, lambda m: m.pop("version"), "shape"),
    (2, lambda m: m.update(version=3), "version 1 or 2, got 3"),
    (2, lambda m: m.update(count=10**12), "can hold"),
    (2, lambda m: m["scales"].update(codebook=[0.0] * 3), "out of bounds"),
    (2, lambda m: m["quats"].update(files=["../../etc/passwd"]), "plain names"),
    (2, lambda m: m["quats"].update(files=["none.webp"]), "none.webp"),
    (2, lambda m: m.clear(), "version 1 or 2, got 'none'"),
    (1, lambda m: m["means"].update(shape=[10**12, 3]), "can hold"),
    (1, lambda m: m["means"].update(shape=[301 + 31, 3]), "a picture of 320 pixels for 332 Gaussians"),
    (1, lambda m: m["sh0"].update(mins=[0.0] * 3), "broadcast"),
    (1, lambda m: m["shN"].update(files=["sh0.webp", "shN_labels.webp"]), "32 is not in list"),
    (1, lambda m: m["quats"].update(files=["sh0.webp"]), "whose alpha is not 252 to 255"),
]


@pytest.mark.parametrize(("version", "change", "says"), BROKEN_SOG)
def test_a_broken_sog_is_refused(tmp_path, version, change, says):
    edit = edit_tables(change, "meta.json")
    if version == 2:
        path = saved(tmp_path / "a.sog", zipped(edit(unzipped(splat_bytes(small(300), ".sog")))))
    else:
        path = write_sog_v1(tmp_path / "a", small(300, 1))
        saved(path / "meta.json", edit({"meta.json": (path / "meta.json").read_bytes()})["meta.json"])
    with pytest.raises(SceneError, match=says) as caught:
        read_frame(path)
    assert "\n" not in str(caught.value) and str(caught.value).count("a.sog") == version - 1


def edited_glb(change):
    glb = glb_bytes(small(3, 0))
    end = 20 + int.from_bytes(glb[12:16], "little")
    document = json.loads(glb[20:end])
    change(document)
    text = json.dumps(document).encode()
    return glb[:12] + len(text).to_bytes(4, "little") + glb[16:20] + text + glb[end:]


def widened(content):
    """A lossless picture that claims to be as large as can be."""
    return content[:21] + b"\xff\xff\xff\x0f" + content[25:] if content[12:16] == b"VP8L" else content


def many_attributes(document):
    document["meshes"][0]["primitives"][0]["attributes"].update({f"_{i}": 0 for i in range(20_000)})
    document["scenes"][0]["nodes"] = [0] * 400


def bombs():
    head = struct.pack(SPZ_HEAD, b"NGSP", 3, 1000, 0, 12, 0, 0)
    yield "rows.spz", gzip.compress(struct.pack(SPZ_HEAD, b"NGSP", 3, 2**32 - 1, 3, 12, 0, 0)), "can hold"
    yield "short.spz", gzip.compress(head + bytes(100)), "what gaussforge cannot read"
    four = struct.pack(SPZ_HEAD + "I12x", b"NGSP", 4, 100, 0, 12, 0, 1, 32)
    yield "four.spz", four + struct.pack("<QQ", 0, 1 << 60), "got"
    sog = unzipped(splat_bytes(small(3, 0), ".sog"))
    yield "zip.sog", zipped(sog | {"means_l.webp": bytes(1 << 24)}, zipfile.ZIP_DEFLATED), "unpacks to"
    for method in (zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA):  # zipfile unpacks these whole, whatever size an entry states
        yield f"method{method}.sog", zipped({"meta.json": "{}"}, method), "neither stored nor deflated"
    wide = zipped({name: widened(content) for name, content in sog.items()})
    yield "picture.sog", wide, "WebP for 3 Gaussians: Image size"
    packed = ["packed_position", "packed_rotation", "packed_scale", "packed_color"]
    ends = [f"{e}_{w}{a}" for w in ("", "scale_") for e in ("min", "max") for a in "xyz"]
    lines = ["ply", "format binary_little_endian 1.0", f"element chunk {10**9}", *(f"property float {n}" for n in ends)]
    lines += [f"element vertex {256 * 10**9}", *(f"property uint {n}" for n in packed), "end_header", ""]
    yield "rows.ply", "\n".join(lines).encode(), "truncated"
    glb = glb_bytes(small(3, 0))
    yield "rows.glb", glb.replace(b'"count":3', b'"count":9').replace(b'"count": 3', b'"count": 9'), "buffer of"
    yield "children.glb", edited_glb(lambda d: d.update(nodes=[{"children": [0] * 9_000}])), "at most 10000 nodes"
    yield "roots.glb", edited_glb(lambda d: d.update(scenes=[{"nodes": [0] * 1_000_000}])), "at most 10000 nodes"
    yield "meshes.glb", edited_glb(lambda d: d["meshes"][0].update(primitives=[{}] * 20_000)), "at most 10000 nodes"
    yield "attributes.glb", edited_glb(many_attributes), "as many Gaussians as 168 bytes can hold, got 1200"
    yield "short.glb", edited_glb(lambda d: d["buffers"][0].update(byteLength=10**12)), "a buffer of 1000000000000"
    yield "twice.glb", edited_glb(lambda d: d.update(buffers=d["buffers"] * 100_000)), "every buffer once"
    yield "long.gltf", b'{"buffers": [' + b" " * (1 << 24), "JSON of at most 16777216 bytes"


@pytest.mark.parametrize(("name", "data", "says"), list(bombs()), ids=lambda v: v if isinstance(v, str) else "")
def test_a_bomb_takes_little_work(tmp_path, name, data, says):
    path = saved(tmp_path / name, data)
    with few_calls(1_000_000), pytest.raises(SceneError, match=says):
        read_frame(path)


def test_buffers_lie_beside_a_gltf_by_their_escaped_names(tmp_path):
    glb = edited_glb(lambda d: d["buffers"][0].update(uri="my%20b%C3%BCffer.bin"))
    end = 20 + int.from_bytes(glb[12:16], "little")
    path = saved(tmp_path / "a.gltf", glb[20:end])
    with pytest.raises(SceneError, match=r"a\.gltf: expected its buffer my büffer\.bin in its folder: No such file"):
        read_frame(path)
    saved(tmp_path / "my büffer.bin", glb[end + 8 :])
    np.testing.assert_array_equal(read_frame(path).means, small(3, 0).means)


@pytest.mark.parametrize("name", ["a.spz", "a.sog", "a.splat", "a.glb", "a.gltf", "a.ply", "a.ksplat", "a"])
@pytest.mark.parametrize("read", [read_frame_header, read_frame])
def test_what_is_none_of_them_is_refused_in_a_line(tmp_path, name, read):
    for data in (b"", b"{}", b"\x1f\x8b", b"not a splat at all"):
        with pytest.raises(SceneError, match="expected") as caught:
            read(saved(tmp_path / name, data))
        assert name in str(caught.value) and "\n" not in str(caught.value)


def test_a_missing_file_and_library_are_said_and_the_library_writes_nothing_itself(tmp_path, monkeypatch, capfd):
    with pytest.raises(SceneError, match=r"none\.spz: expected \.spz: No such file"):
        read_frame_header(tmp_path / "none.spz")
    path = saved(tmp_path / "a.spz", splat_bytes(small(100), ".v3.spz"))
    capfd.readouterr()
    read_frame(path)
    assert capfd.readouterr() == ("", "")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(SceneError, match=r"a\.spz: .*pip install gaussforge"):
        read_frame(path)


BELOW_A_LIMIT = """
import resource, sys
from airgs_codec import read
resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 28, 1 << 28))
print(len(read(sys.argv[1])))
"""


def test_a_lower_limit_that_is_set_already_stays(tmp_path):
    """ulimit -f of a shell; a process may not raise it again."""
    path = saved(tmp_path / "a.spz", splat_bytes(small(100), ".v3.spz"))
    done = subprocess.run([sys.executable, "-c", BELOW_A_LIMIT, path], capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("100\n", "")
