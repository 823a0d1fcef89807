"""Sound in a package: one file a group, at the time of its frames, in the tables, the MPD and the figures."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from airgs_codec.decoder.sound import decode_all
from airgs_codec.media.mp4 import sound_segment
from airgs_codec.package.layout import SOUND_INIT_NAME
from airgs_codec.package.tables import file_entry
from tests.faces import (
    NO_FILE,
    EncodeSettings,
    FormatError,
    Streams,
    airgs_encode,
    airgs_manifest,
    check_group,
    encode,
    encode_sound,
    open_package,
    open_sequence,
    sound_path,
    validate,
)
from tests.support.chirps import chirp, moment, write_chirp
from tests.support.mutations import apply, honest, read_files, rewrite
from tests.support.refusals import findings
from tests.support.scenes import moving_frames, write_sequence

FPS = Fraction(30_000, 1001)
SETTINGS = EncodeSettings(calibrate="none", measure_pictures=0, group_frames=13, preset="veryfast", threads=2)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    root = tmp_path_factory.mktemp("sound")
    sequence = open_sequence(write_sequence(root / "scene", moving_frames(40, 39)), fps=FPS)
    sound = encode_sound(write_chirp(root / "a.wav", 2.0), len(sequence) / sequence.fps)
    encode(replace(sequence, sound_track=sound), root / "with", SETTINGS)
    encode(sequence, root / "without", SETTINGS)
    return root


def test_it_is_heard_at_the_time_of_its_frames(folder):
    package = open_package(folder / "with")
    assert validate(folder / "with") == []
    samples = decode_all(package)
    assert samples.shape == (round(39 / FPS * 48_000), 1)
    for second in (0.1, 13 / float(FPS), 26 / float(FPS), 1.2):  # the ends of groups among them
        middle = round(48_000 * second)
        assert abs(moment(samples[middle - 1024 : middle + 1024, 0].astype(float)) - second) < 0.002
    assert np.abs(samples[2000:60_000, 0] / 32768 - chirp(2.0)[2000:60_000]).max() < 0.1  # no seams


def test_packets_are_in_the_group_in_whose_time_they_start(folder):
    m = open_package(folder / "with").manifest
    spans = [m.packets(group.start, group.stop) for group in m.groups]
    assert [(span.start, span.stop) for span in spans] == [(0, 22), (22, 44), (44, 66)]
    assert m.packets(0, 1) == range(2) and m.packets(1, 2) == range(2, 4)
    fast = replace(m, frame_rate=[100, 1])
    assert [len(fast.packets(frame, frame + 1)) for frame in range(4)] == [1, 0, 1, 0]


def test_nothing_else_differs_from_the_package_without_sound(folder):
    sound, silent = read_files(folder / "with"), read_files(folder / "without")
    assert set(sound) - set(silent) == {SOUND_INIT_NAME, *(sound_path(n) for n in (1, 2, 3))}
    same = {path for path in silent if path.split("/")[0] in ("key", "state", "init.mp4")}
    assert same and all(sound[path] == silent[path] for path in same)


def test_the_mpd_has_a_set_of_its_own(folder):
    m = open_package(folder / "with").manifest
    (listed,) = [found for found in Streams.of(m).sets() if found.role == "sound"]
    (stream,) = listed.representations
    assert (stream.media, stream.init) == ("sound/$Number$.m4a", SOUND_INIT_NAME)
    assert [(run.number, run.start, run.count) for run in stream.timeline] == [(1, 0, 3)]
    text = (folder / "with" / "manifest.mpd").read_text()
    assert 'contentType="audio" mimeType="audio/mp4" codecs="opus"' in text


def test_broken_sound_is_found(folder):
    package, files = open_package(folder / "with"), read_files(folder / "with")
    packets = encode_sound(folder / "a.wav", Fraction(2)).packets
    cases = {
        "bad_sound": sound_segment([b"\xff\xff\xff\xff"] * 22, 22),
        "bad_sound ": sound_segment(packets[:22], 21),
        "bad_sound  ": sound_segment(packets[:21], 22),
        "bad_sound   ": b"no boxes",
    }
    for reason, data in cases.items():
        broken = apply(files, rewrite(sound_path(2), lambda _, data=data: data), honest)
        (finding,) = findings(broken)
        assert finding.reason == reason.strip() and "\n" not in str(finding)
        assert len(decode_all(open_package(folder / "with"))) == round(39 / FPS * 48_000)
    m, entry = package.manifest, package.manifest.groups.places.entry(1)
    for sound in (None, NO_FILE, file_entry(b"")):
        with pytest.raises(FormatError):
            check_group(m, entry, replace(m.groups[1], sound=sound), "group")
    with pytest.raises(FormatError, match="where, and only where"):
        check_group(replace(m, sound=None), entry, m.groups[1], "group")


def test_the_commands_take_it_and_say_it(folder, tmp_path, capsys):
    scene, sound = str(folder / "scene"), str(folder / "a.wav")
    options = ["-o", str(tmp_path / "out"), "--preset", "quick", "--measure-pictures", "0", "--fps", "30"]
    assert airgs_encode([scene, *options, "--audio", sound]) == 0
    assert f"sound: {sound}: cut after 1.30 s, where the pictures end" in capsys.readouterr().out
    assert airgs_manifest(["inspect", str(tmp_path / "out")]) == 0
    assert "sound: Opus, mono, " in capsys.readouterr().out
    for wrong, words in (
        ([scene, *options, "--audio", scene + "/000000.ply"], "expected a file with sound"),
        ([scene, *options, "--audio", sound, "--follow"], "--audio: expected a sequence that is whole"),
    ):
        assert airgs_encode(wrong) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert words in line
