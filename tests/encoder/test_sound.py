"""Sound in a package: one file a group, at the time of its frames, in the tables, the MPD and the figures."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from airgs_codec.decoder.sound import decode_all
from airgs_codec.media.mp4 import sound_segment
from tests import faces
from tests.faces import FormatError, airgs_encode, airgs_manifest, check_group, open_package, sound_path
from tests.support.chirps import chirp, moment, write_chirp
from tests.support.mutations import apply, honest, read_files, rewrite
from tests.support.packages import NTSC
from tests.support.refusals import findings
from tests.support.scenes import moving_frames, write_sequence

SAMPLES = round(39 / NTSC * 48_000)


@pytest.fixture(scope="module")
def package(package_of):
    return open_package(package_of("sound"))


def test_it_is_heard_at_the_time_of_its_frames_and_packets_are_in_the_group_in_whose_time_they_start(package):
    assert faces.validate(package.files.path) == []
    samples, m = decode_all(package), package.manifest
    assert samples.shape == (SAMPLES, 1)
    for second in (0.1, 13 / float(NTSC), 26 / float(NTSC), 1.2):  # the ends of groups among them
        middle = round(48_000 * second)
        assert abs(moment(samples[middle - 1024 : middle + 1024, 0].astype(float)) - second) < 0.002
    assert np.abs(samples[2000:60_000, 0] / 32768 - chirp(2.0)[2000:60_000]).max() < 0.1  # no seams
    assert [m.packets(group.start, group.stop) for group in m.groups] == [range(22), range(22, 44), range(44, 66)]
    assert m.packets(0, 1) == range(2) and m.packets(1, 2) == range(2, 4)
    fast = replace(m, frame_rate=[100, 1])
    assert [len(fast.packets(frame, frame + 1)) for frame in range(4)] == [1, 0, 1, 0]


def test_the_mpd_has_a_set_of_its_own_and_nothing_else_differs_from_the_package_without_sound(package, package_of):
    sound, silent = read_files(package.files.path), read_files(package_of("silent"))
    assert set(sound) - set(silent) == {faces.SOUND_INIT_NAME, *(sound_path(n) for n in (1, 2, 3))}
    same = {path for path in silent if path.split("/")[0] in ("keyframe", "delta", "init.mp4")}
    assert same and all(sound[path] == silent[path] for path in same)
    (listed,) = [found for found in faces.Streams.of(package.manifest).sets() if found.role == "sound"]
    (stream,) = listed.representations
    assert (stream.media, stream.init) == ("sound/$Number$.m4a", faces.SOUND_INIT_NAME)
    assert [(run.number, run.start, run.count) for run in stream.timeline] == [(1, 0, 3)]
    assert b'contentType="audio" mimeType="audio/mp4" codecs="opus"' in sound["manifest.mpd"]


def test_broken_sound_is_found(package, tmp_path):
    m, files = package.manifest, read_files(package.files.path)
    packets = faces.encode_sound(write_chirp(tmp_path / "a.wav", 2.0), Fraction(2)).packets
    segments = [([b"\xff\xff\xff\xff"] * 22, 22), (packets[:22], 21), (packets[:21], 22)]
    for data in (*(sound_segment(*segment) for segment in segments), b"no boxes"):
        broken = apply(files, rewrite(sound_path(2), lambda _, data=data: data), honest)
        (finding,) = findings(broken)
        assert finding.reason == "bad_sound" and "\n" not in str(finding)
    entry = m.groups.places.entry(1)
    for sound in (None, faces.NO_FILE, faces.file_entry(b"")):
        with pytest.raises(FormatError):
            check_group(m, entry, replace(m.groups[1], sound=sound), "group")
    with pytest.raises(FormatError, match="where, and only where"):
        check_group(replace(m, sound=None), entry, m.groups[1], "group")


def test_the_commands_take_it_and_say_it(tmp_path, capsys):
    scene = str(write_sequence(tmp_path / "scene", moving_frames(40, 39)))
    sound, out = str(write_chirp(tmp_path / "a.wav", 2.0)), str(tmp_path / "out")
    words = [scene, "-o", out, *["--preset", "fast", "--measure-pictures", "0", "--fps", "30", "--audio"]]
    assert airgs_encode([*words, sound]) == 0
    assert f"sound: {sound}: cut after 1.30 s, where the pictures end" in capsys.readouterr().out
    assert airgs_manifest(["inspect", out]) == 0
    assert "sound: Opus, mono, " in capsys.readouterr().out
    whole = "--audio: expected a sequence that is whole"
    for wrong, said in (([scene + "/000000.ply"], "expected a file with sound"), ([sound, "--follow"], whole)):
        assert airgs_encode([*words, *wrong]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert said in line
