"""Every format: what is written is read back within the steps of its quantisers, and by the libraries of others."""

import importlib.util
from dataclasses import replace

import gsply
import numpy as np
import pygltflib
import pytest
from scipy.spatial import cKDTree

import airgs_codec as airgs
from airgs_codec.scene.formats.form import Losses
from tests import faces
from tests.faces import COMPRESSED, FRAMES, GLTF, SOG, SPLAT, SPZ, Gaussians, SceneError, read_frame
from tests.support.paths import GOLDEN
from tests.support.scenes import random_gaussians

HALF_BYTE = 0.5 / 255
FLOAT = 1e-6  # of logarithms and logits that went through their inverses
CHUNK = 256


def written(tmp_path, form, g):
    """What was written, its rows in the order of those that are read, and what is read."""
    path, g = tmp_path / f"a.{form.key}", Losses(form.holds, form.name).fit(g, "a")
    form.write(path, g)
    assert faces.format_of(path) is form
    back = read_frame(path)
    assert len(back) == len(g)
    if not form.holds.keeps_rows:
        order = cKDTree(g.means).query(back.means)[1]
        assert len(set(order.tolist())) == len(g)
        g = g.take(order)
    return g, back


def chunk_spans(values):
    """(N, 3) the width of the range of every row's chunk of 256, of rows in the order of a file."""
    chunks = [values[i : i + CHUNK] for i in range(0, len(values), CHUNK)]
    return np.concatenate([np.broadcast_to(np.ptp(c, axis=0), c.shape) for c in chunks])


def steps(form, g):
    """Largest errors of positions, log-scales, alpha, colour, SH and components of a rotation, rows as in the file."""
    if form is SPZ:  # 2^-12; 1/16; bytes; 10 bits of a sign and 1 / sqrt 2
        return 2**-13, 1 / 32, HALF_BYTE, HALF_BYTE / 0.15, 0.5 / 128, 0.5 / 511 * np.sqrt(0.5)
    if form is SPLAT:  # the quaternion's 1 is 127 of 128
        return 0, FLOAT, HALF_BYTE, HALF_BYTE / faces.SH_C0, 0, 1 / 128
    if form is COMPRESSED:
        means, sizes, colours = (chunk_spans(v) / 2 for v in (g.means, g.log_scales, g.sh_dc))
        bits = np.array([2047, 1023, 2047])
        return means / bits, sizes / bits, HALF_BYTE, colours / 255, 4 / 256, 0.5 / 1023 * np.sqrt(2)
    if form is SOG:  # positions: 16 bits of ln(1 + |x|), with the derivative of its inverse; rounded down
        logs = np.ptp(np.sign(g.means) * np.log1p(np.abs(g.means)), axis=0)
        return logs / 65535 * (1.01 + np.abs(g.means)), None, 2 * HALF_BYTE, None, None, 0.5 / 255 * np.sqrt(2)
    alpha = 1 / 1000 if form is GLTF else 0  # 0 and 1 have infinite logits: the reader stays a quarter of 1/255 away
    return 0, FLOAT if form is GLTF else 0, alpha, 0, 0, FLOAT


def expect_within(error, step):
    assert (error <= np.asarray(step) * 1.001 + FLOAT).all()


def expect_close(form, g, back):
    means, sizes, alpha, colour, harmonics, rotation = steps(form, g)
    expect_within(np.abs(back.means - g.means), means)
    expect_within(np.abs(back.opacities() - g.opacities()), alpha)
    unit = back.quaternions / np.linalg.norm(back.quaternions, axis=1, keepdims=True)
    turned = unit * np.sign((unit * g.quaternions).sum(axis=1, keepdims=True))
    # the largest component follows from three others that are off by a step, the length from four
    expect_within(np.linalg.norm(turned - g.quaternions, axis=1), 2 * np.sqrt(3) * rotation)
    for values, read, step in ((g.log_scales, back.log_scales, sizes), (g.sh_dc, back.sh_dc, colour)):
        if step is None:  # a palette is at least as good as 256 levels that lie evenly
            assert np.sqrt(((read - values) ** 2).mean()) <= np.ptp(values) / 255 / 2
        else:
            expect_within(np.abs(read - values), step)
    if harmonics is None:
        assert np.sqrt(((back.sh_rest - g.sh_rest) ** 2).mean()) <= np.ptp(g.sh_rest) / 255 if g.sh_rest.size else True
    else:
        expect_within(np.abs(back.sh_rest - g.sh_rest), harmonics)


@pytest.fixture(params=FRAMES, ids=lambda form: form.key)
def form(request):
    return request.param


@pytest.fixture(scope="module")
def fox():
    return faces.decode(faces.open_package(GOLDEN / "fox"), 1)


def test_a_real_frame_comes_back_within_a_step_and_in_its_order_where_the_table_says_so(tmp_path, form, fox):
    g, back = written(tmp_path, form, fox)
    expect_close(form, g, back)
    near = np.linalg.norm(back.means - fox.means, axis=1) < 1e-3
    assert near.all() == form.holds.keeps_rows
    if form is COMPRESSED:  # neighbours share a chunk, so that steps are small
        assert np.abs(back.means - g.means).mean() < np.ptp(fox.means) / 1023 / 8
    if form is faces.INRIA:  # plain .ply loses nothing
        assert airgs.write(fox, tmp_path / "a.ply") == []


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_every_degree_comes_back_in_its_order(tmp_path, form, degree):
    g = random_gaussians(600, degree)
    g = replace(g, sh_dc=np.clip(g.sh_dc, -1.7, 1.7), sh_rest=np.clip(g.sh_rest, -0.9, 0.9))
    g, back = written(tmp_path, form, g)
    assert back.sh_degree == min(degree, form.holds.sh_degree)
    if form is SOG:  # random SH is no material for a palette: each coefficient is still nearest to its own
        errors = np.abs(back.sh_rest[:, :, None] - g.sh_rest[:, None]).mean(axis=(0, 3))
        assert errors.argmin(axis=1).tolist() == [*range(g.sh_rest.shape[1])] if degree else True
        g, back = g.with_degree(0), back.with_degree(0)
    expect_close(form, g, back)


def test_extremes_are_written_without_a_warning_and_counted(tmp_path, form):
    g = Gaussians(*(getattr(random_gaussians(300, 1), name).copy() for name in Gaussians.__slots__))
    g.opacity_logits[:100], g.opacity_logits[100:200] = np.inf, -np.inf
    g.sh_dc.clip(-1.7, 1.7, out=g.sh_dc)
    g.sh_dc[:7], g.sh_rest[:5], g.log_scales[:3], g.quaternions[0] = 9, -5, 100, 0
    path, losses = tmp_path / f"a.{form.key}", Losses(form.holds, form.name)
    form.write(path, losses.fit(g, "frame 0"))
    back = read_frame(path)
    assert len(back) == 300 and all(np.isfinite(getattr(back, name)).all() for name in back.__slots__)
    text = " ".join(losses.lines())
    assert "zero quaternions" in text
    for name, words, rows in (("sh_dc", "colours", 7), ("sh_rest", "SH", 5), ("log_scales", "sizes", 3)):
        if name in {name for name, _, _ in form.holds.ranges}:
            assert f"has {words} from" in text and f"cut off in {rows} of 300" in text
    for g in (random_gaussians(1), random_gaussians(300).take(np.zeros(300, np.intp))):  # one Gaussian, one place
        form.write(path, Losses(form.holds, form.name).fit(g, "a"))
        np.testing.assert_allclose(read_frame(path).means, g.means, atol=2e-4)


def test_far_positions_take_longer_steps_and_the_farthest_are_refused(tmp_path):
    g = random_gaussians(50, 0)
    far, back = written(tmp_path, SPZ, replace(g, means=g.means * np.float32(1e5)))
    step = 2.0 ** -np.floor(np.log2((2**23 - 1) / np.abs(far.means).max()))
    assert 2**-12 < step < 1
    np.testing.assert_allclose(back.means, far.means, atol=step / 2)
    with pytest.raises(SceneError, match="positions within"):
        written(tmp_path, SPZ, replace(g, means=g.means * np.float32(1e9)))


def test_gsply_reads_the_same_of_spz_as_gaussforge(tmp_path, fox):
    _, back = written(tmp_path, SPZ, fox)
    data = gsply.read_spz(tmp_path / "a.spz")
    for theirs, ours in (("means", "means"), ("scales", "log_scales"), ("sh0", "sh_dc"), ("shN", "sh_rest")):
        np.testing.assert_allclose(getattr(data, theirs), getattr(back, ours), atol=1e-5)
    assert np.abs((data.quats * back.quaternions).sum(axis=1)).min() > 1 - 1e-5


def test_a_glb_is_one_that_others_read(tmp_path, fox):
    written(tmp_path, GLTF, fox)
    document = pygltflib.GLTF2().load(str(tmp_path / "a.glb"))
    primitive, blob = document.meshes[0].primitives[0], document.binary_blob()
    assert document.extensionsUsed == ["KHR_gaussian_splatting"] and primitive.mode == 0
    accessor = document.accessors[primitive.attributes.POSITION]
    assert accessor.count == len(fox) and document.buffers[0].byteLength == len(blob)
    np.testing.assert_allclose(accessor.min, fox.means.min(axis=0), rtol=1e-6)
    np.testing.assert_allclose(accessor.max, fox.means.max(axis=0), rtol=1e-6)
    view = document.bufferViews[accessor.bufferView]
    data = np.frombuffer(blob[view.byteOffset : view.byteOffset + view.byteLength], "<f4")
    np.testing.assert_array_equal(data.reshape(-1, 3), fox.means)


def test_a_missing_library_is_said(tmp_path, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    for form in (SPZ, SOG):
        with pytest.raises(SceneError, match=r"need (gsply|gaussforge): pip install \1"):
            form.write(tmp_path / f"a.{form.key}", random_gaussians(9))
    assert not any(tmp_path.iterdir())
