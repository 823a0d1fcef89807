"""What `progress=` takes: a function, or a class of bars."""

from typing import ClassVar

from tqdm.auto import tqdm

import airgs_codec as airgs
from airgs_codec.progress import told
from tests.support.scenes import moving_frames


class Bars(tqdm):
    made: ClassVar = []

    def __init__(self, *arguments, **named):
        super().__init__(*arguments, **named)
        Bars.made.append(self)


def test_a_class_of_bars_shows_one_for_each_stage_whose_end_may_move(capsys):
    Bars.made.clear()
    progress = told(Bars)
    for stage, done, total in [("a", 1, 4), ("a", 2, 4), ("b", 0, 3), ("b", 1, 5), ("b", 5, 5), ("b", 1, 2)]:
        progress(stage, done, total)
    assert [(bar.desc.strip(": "), bar.n, bar.total) for bar in Bars.made] == [("a", 2, 4), ("b", 5, 5), ("b", 1, 2)]
    assert [bar.disable for bar in Bars.made] == [True, True, False]  # tqdm's mark of a closed bar
    progress.close()


def test_encoding_and_comparing_take_both(tmp_path, capsys):
    Bars.made.clear()
    told_of = []
    camera = airgs.Camera.look_at((0, 0, -4), (0, 0, 0), size=(64, 48))
    sequence = airgs.Sequence.from_arrays(moving_frames(60, 2), cameras=[camera])
    settings = airgs.EncodeSettings(calibrate="none", measure_pictures=0, preset="ultrafast")
    airgs.encode(sequence, tmp_path / "a.airgs", settings, progress=Bars)
    airgs.compare(sequence, tmp_path / "a.airgs", progress=lambda *told: told_of.append(told))
    assert Bars.made and all(bar.n == bar.total for bar in Bars.made)
    assert told_of[-1] == ("comparing", 2, 2)


def test_encoding_is_one_stage_that_ends_where_it_was_said_to(tmp_path):
    told_of = []
    sequence = airgs.Sequence.from_arrays(moving_frames(60, 4))
    settings = airgs.EncodeSettings(
        calibrate="none", measure_pictures=1, decide_pictures=2, preset="ultrafast", group_frames=2
    )
    airgs.encode(sequence, tmp_path / "a.airgs", settings, progress=lambda *words: told_of.append(words))
    encoding = [words for words in told_of if words[0].startswith("encoding")]
    assert {name for name, _, _ in encoding} >= {"encoding: states, 1 of 2", "encoding: quality, 2 of 2", "encoding"}
    done, totals = zip(*[words[1:] for words in encoding], strict=True)
    assert list(done) == sorted(done) and list(totals) == sorted(totals) and done[-1] == totals[-1]
