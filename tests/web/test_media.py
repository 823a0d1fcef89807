"""The player's media part in a real browser: exact luma, frames as the decoder shows them, refusals, faults."""

import gzip
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import pytest

from airgs_codec.coding.atlas import picture_size
from airgs_codec.coding.channels import colours
from airgs_codec.encoder import streams
from tests.faces import REPR_DIGEST, decode_frames, open_package, repr_digest
from tests.support.browser import Answer, missing
from tests.support.growing import Growing
from tests.support.packages import Encoded
from tests.support.page import PICTURED, do_tasks, open_pictured
from tests.support.paths import VALID
from tests.support.refusals import cases as cases_of_refusals
from tests.support.regions import QUICK
from tests.support.scenes import moving_frames, room_frames

FOX = open_pictured("golden/fox")

pytestmark = pytest.mark.skipif(bool(missing()), reason=f"not here: {', '.join(missing())}")


@pytest.fixture(scope="module")
def encoded(tmp_path_factory):
    """Folder of packages: `pages`, whose atlases are all cut into pages, and `still`, two groups alike."""
    folder, settings = tmp_path_factory.mktemp("encoded"), replace(QUICK, segment_s=0.2)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(streams, "picture_size", partial(picture_size, macroblocks=16))
        Encoded(lambda: [moving_frames(600, 7)], settings, cameras=True)(folder / "pages")
    Encoded(lambda: [room_frames(600, 1, 1) * 2] * 2, settings, fps=4, cameras=True)(folder / "still")
    return folder


def frames_of(p, rung):
    """Float32 of means, quaternions, log-scales, alpha and colours of every frame."""
    for frame in decode_frames(p, 0, p.manifest.frames, **rung):
        g = frame.gaussians
        alpha = 1 / (1 + np.exp(-g.opacity_logits.astype(np.float64)))
        parts = (g.means, g.quaternions, g.log_scales, alpha, colours(g.sh_dc, g.sh_rest))
        yield np.concatenate([np.asarray(part, "<f4").ravel() for part in parts]).tobytes()


RUNGS = [
    (name, {"keyframe_quality": q, "level": j, "tiers": tiers})
    for name in PICTURED
    for m in [open_pictured(name).manifest]
    for best, last in [(len(m.qualities) - 1, len(m.levels) - 1)]
    for q, j, tiers in {(0, 0, m.tiers), (best, last, m.levels[-1].tiers), (0, last, m.tiers), (best, 0, 1)}
]
ENCODED = {
    "pages": {"keyframe_quality": 0, "level": 0, "tiers": 1},
    "still": {"keyframe_quality": 1, "level": 0, "tiers": 2},
}
READ = "golden/room"


@pytest.fixture(scope="module")
def frames(encoded):
    steps, made = {}, {}
    wanted = {f"{number}": (name, open_pictured(name), rung) for number, (name, rung) in enumerate(RUNGS)}
    wanted |= {name: (f"encoded/{name}", open_package(encoded / name), rung) for name, rung in ENCODED.items()}
    for name, (url, of, rung) in wanted.items():
        made |= {f"/expected/{name}/{i}": data for i, data in enumerate(frames_of(of, rung))}
        asked = {"quality": rung["keyframe_quality"], "level": rung["level"], "tiers": rung["tiers"]}
        steps[name] = "frames", {"url": url, "expected": f"/expected/{name}"} | asked
    best = RUNGS.index((READ, {"keyframe_quality": 0, "level": 0, "tiers": 2}))
    read = {"rung": "Q0+L0", "frames": [3, 1, 0, 2], "expected": f"/expected/{best}"}
    steps["reader"] = "reading", {"url": READ} | read
    steps["flips"] = "flips", {"url": f"/{READ}/", "level": 0, "seed": 3, "count": 60, "seconds": 30}
    return do_tasks(steps, made, {"encoded": encoded})


@pytest.mark.parametrize("number", range(len(RUNGS)), ids=[f"{name} {rung}" for name, rung in RUNGS])
def test_every_frame_is_the_decoders(frames, number):
    report = frames[f"{number}"]
    assert report["frames"] == open_pictured(RUNGS[number][0]).manifest.frames
    assert all(error <= 1e-6 for error in report["worst"].values()), report


def test_atlases_in_pages_are_put_together_and_a_group_may_have_no_keyframe_pictures(frames, encoded):
    """The second group of `still` differs by nothing."""
    m, (_, second) = (open_package(encoded / "pages").manifest, open_package(encoded / "still").manifest.groups)
    assert all(atlas.pages > 1 for atlas in (m.groups[0].tiers[0].qualities[0], m.groups[0].levels[0]))
    assert second.base == 1 and not any(file.bytes for tier in second.tiers for file in tier.pictures)
    assert [frames[name].get("frames") for name in ENCODED] == [m.frames, second.stop], frames["still"]
    assert all(error <= 1e-6 for name in ENCODED for error in frames[name]["worst"].values()), frames


def test_frames_are_read_in_any_order_from_a_group_that_keeps_rows(frames):
    report = frames["reader"]
    assert len(report) == 6 and all(error <= 1e-6 for error in report.values()), report


def test_a_flipped_bit_of_a_coded_picture_shows_no_other_values(frames):
    """Digests aside, as if they had been made anew: the checksums of decoded luma refuse what the decoder lets pass."""
    came = frames["flips"]
    assert came["tried"] > 0 and came["other"] == 0 and came["refused"] > came["same"]


# Every refusal is tested in Node (web/test/unit/packages.test.ts): here those of files that are no tables, and how one
# of each kind of table comes out of the worker.
OF_FILES = (
    "bad_picture", "bad_sidecar", "count_mismatch", "hash_mismatch", "missing_entry", "missing_file", "size_mismatch",
)  # fmt: skip
OF_TABLES = ("not_json", "not_json-group", "bad_value-page-short", "too_large")
REFUSED = {
    name: case for name, case in cases_of_refusals().items() if case.reason in OF_FILES or name in OF_TABLES
}  # fmt: skip


@pytest.fixture(scope="module")
def refusals():
    made = {}
    for name, case in REFUSED.items():
        files = case.package()
        made |= {f"/{name}/{path}": files.get(path, Answer(status=404)) for path in case.files}
    folders = {name: VALID / case.base for name, case in REFUSED.items()}
    return do_tasks({name: ("luma", {"url": name}) for name in REFUSED}, made, folders)


@pytest.mark.parametrize("name", REFUSED)
def test_broken_packages_are_refused(refusals, name):
    error = refusals[name].get("error", {})
    assert (error.get("name"), error.get("reason")) == ("FormatError", REFUSED[name].reason), refusals[name]


# Faults of servers

TABLE = "group/1.json.gz"
TABLE_BYTES = FOX.files.path.joinpath(TABLE).read_bytes()
KEY = "keyframe/T0/Q0/1.m4s"
OTHER = TABLE_BYTES[:-1] + bytes([TABLE_BYTES[-1] ^ 1])
ROOT = FOX.files.path.joinpath("airgs.json").read_bytes()
HEADERS = 350  # bytes of each answer, which pages are not told
ROOTS = {  # answer for airgs.json -> what is opened, or why not
    "right": (Answer(ROOT, headers={REPR_DIGEST: repr_digest(ROOT)}),
              {"groups": 2, "bytes": len(ROOT) + HEADERS}),
    "wrong": (Answer(ROOT, headers={REPR_DIGEST: repr_digest(b"another")}), "hash_mismatch"),
    "busy": (Answer(status=503), "TransportError"),
    "away": (Answer(dropped=True), "TransportError"),
    "missing": (Answer(status=404), "missing_file"),
}  # fmt: skip
FAULTS = {  # answers for the table of the first group -> why it cannot be had; later answers are the file
    "none": ([], None),
    "wrong bytes": ([Answer(OTHER)], None),
    "wrong length": ([Answer(TABLE_BYTES + b"more")], None),
    "unpacked by the browser": ([Answer(TABLE_BYTES, headers={"Content-Encoding": "gzip"})], None),
    "unpacked by the server": ([Answer(gzip.decompress(TABLE_BYTES))], None),
    "403": ([Answer(b"", 403)], "missing_file"),
    "always a page": ([Answer(b"<html>" * 999)] * 9, "size_mismatch"),
    "truncated": ([Answer(TABLE_BYTES, lost=40)] * 2, None),
    "500": ([Answer(b"", 500)], None),
    "404": ([Answer(b"", 404)], "missing_file"),
    "away: 503": ([Answer(b"", 503)] * 3, None),
    "always wrong bytes": ([Answer(OTHER)] * 9, "hash_mismatch"),
    "always short": ([Answer(TABLE_BYTES[:-1])] * 9, "size_mismatch"),
    "always 500": ([Answer(b"", 500)] * 9, "missing_file"),
    "away: no connection": ([Answer(dropped=True)] * 3, None),
}
ATTEMPTS = 2  # of files that stay wrong, or of a server that is away more often; elsewhere as many as players make


def in_turn(*answers):
    """Answers one after another; once they are used up, the file as it is."""
    return partial(next, iter(answers), None)


@pytest.fixture(scope="module")
def faults(package_of, tmp_path_factory):
    steps, made, folders = {}, {}, {"long": package_of("chirping")}

    def add(name, task, answers, **arguments):
        folder = f"at{len(folders)}"
        folders[folder] = FOX.files.path
        made.update({f"/{folder}/{path}": answer for path, answer in answers.items()})
        steps[name] = task, {"url": folder} | arguments

    for name, (answers, _) in FAULTS.items():
        attempts = {"attempts": ATTEMPTS} if name.startswith(("always", "away")) else {}
        add(name, "fetching", {TABLE: in_turn(*answers)}, paths=[TABLE], **attempts)
    late = in_turn(Answer(TABLE_BYTES, wait_s=20))
    add("slow", "fetching", {TABLE: late}, paths=[TABLE, "group/2.json.gz"], abortMs=700)
    keep = Answer(TABLE_BYTES, headers={"Cache-Control": "max-age=3600"})
    add("kept", "fetching", {TABLE: keep}, paths=[TABLE], times=2)
    fresh = Answer(TABLE_BYTES, headers={"Cache-Control": "no-store"})
    add("kept here", "fetching", {TABLE: fresh}, paths=[TABLE, KEY], times=3)
    for name, (root, _) in ROOTS.items():
        add(f"root {name}", "opening", {"airgs.json": root})
    steps["ahead"] = "ahead", {"url": "long"}
    add("mistakes", "mistakes", {})
    folder = tmp_path_factory.mktemp("growing") / "package"
    growth = Growing(folder, 1, 2, 65, 0)
    folders["growing"] = folder
    made["/growing/airgs.json"] = lambda: (folder.joinpath("airgs.json").read_bytes(), growth.publish())[0]
    steps["growing"] = "growing", {"url": "growing"}
    return do_tasks(steps, made, folders)


@pytest.mark.parametrize("name", FAULTS)
def test_faults_are_gone_about_as_the_players_documentation_says(faults, name):
    _, reason = FAULTS[name]
    (came,) = faults[name]["came"]
    assert came["whole"] == ([] if reason else [TABLE])
    assert [refused for refused, _ in came["refused"].values()] == ([reason] if reason else [])
    assert faults[name]["groups"][0] is not bool(reason)
    assert came["inOrder"] and not came["cached"]
    assert came["progress"] == sorted(came["progress"])
    assert came["progress"][-1] == came["bytes"] if came["progress"] else came["bytes"] == 0
    assert name != "none" or came["bytes"] == len(TABLE_BYTES) + HEADERS


def test_a_batch_that_is_given_up_keeps_what_is_whole(faults):
    (came,) = faults["slow"]["came"]
    assert came["whole"] == ["group/2.json.gz"] and came["refused"] == {}
    assert faults["slow"]["groups"] == [False, True]
    assert came["bytes"] == 2 * HEADERS + len(TABLE_BYTES) - 1 + FOX.manifest.entry("group/2.json.gz").bytes


def test_what_is_kept_by_the_browser_says_nothing_of_the_network_and_by_the_player_is_not_fetched(faults):
    """Of a table and a keyframe file, asked for once the table is there, the keyframe file comes but once."""
    first, again = faults["kept"]["came"]
    assert (first["cached"], again["cached"], again["bytes"]) == (False, True, 0) and first["bytes"] > 0
    assert first["whole"] == again["whole"] == [TABLE]
    _, both, again = faults["kept here"]["came"]
    table, key = len(TABLE_BYTES) + HEADERS, FOX.manifest.entry(KEY).bytes + HEADERS
    assert sorted(both["whole"]) == sorted(again["whole"]) == [TABLE, KEY]
    assert (both["bytes"], both["expected"]) == (table + key, table + key)
    assert (again["bytes"], again["expected"], again["cached"]) == (table, table, False)


@pytest.mark.parametrize("name", ROOTS)
def test_the_root_is_checked_by_its_header_and_a_server_that_is_not_there_is_named_at_once(faults, name):
    came, (_, expected) = faults[f"root {name}"], ROOTS[name]
    error = came.get("error", {})
    assert (error.get("reason", error["name"]) if error else came) == expected


def test_decoding_waits_for_the_screen(faults, package_of):
    """Nothing but what the decoder holds, and one frame, comes before frames are taken."""
    report, frames = faults["ahead"], open_package(package_of("chirping")).manifest.segments[0].stop
    first, *later = report["counts"]
    assert first <= frames // 2 and frames >= 16
    assert all(before <= after for before, after in pairwise(report["counts"]))
    assert later[-1] == report["total"] == report["again"] == frames
    assert report["error"] == "AbortError"


def test_files_that_are_not_at_hand_are_fetched_where_a_table_leads_to_them(faults):
    unread, nothing, early, waiting, closed = faults["mistakes"]
    assert [error["reason"] for error in (unread, nothing)] == ["missing_entry"] * 2
    assert early == FOX.manifest.groups[0].tiers[0].count
    assert [error["name"] for error in (waiting, closed)] == ["AbortError"] * 2


def test_a_growing_package_is_followed_to_its_end(faults):
    report = faults["growing"]
    assert report["seen"] == [[1, True], [2, True], [65, True], [65, False]]
    assert report["start"] == open_pictured("valid/paged").manifest.groups[64].start
