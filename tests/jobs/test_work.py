"""Jobs are done once, whoever does them; what dies, is damaged or comes in another order changes nothing."""

from dataclasses import replace

import pytest

from airgs_codec.jobs.engines import DEATHS, InProcess
from airgs_codec.jobs.job import perform
from tests.faces import FormatError, Job, Processes, Work, WorkError, open_store
from tests.support.jobs import calls, die, die_once, refuse, square, total


@pytest.fixture(scope="module")
def processes():
    engine = Processes(2)
    yield engine
    engine.close()


def squares(folder, count=8):
    return [Job("square", f"number {n}", f"{n:064x}", square, (n, str(folder))) for n in range(count)]


@pytest.mark.parametrize("several", [False, True])
def test_jobs_are_done_once_and_their_results_are_read_by_others(tmp_path, processes, several):
    work = Work(open_store(tmp_path / "work"), processes if several else InProcess())
    jobs, seen = squares(tmp_path), []
    replace(work, progress=lambda *words: seen.append(words)).run(jobs[:5])
    work.run(jobs + jobs)
    assert [work.result(job) for job in jobs] == [n * n for n in range(8)]
    assert calls(tmp_path) == {str(n): 1 for n in range(8)}
    assert seen == [("square", done, 5) for done in range(6)]
    joined = Job("total", "", "f" * 64, total, tuple(job.result for job in jobs))
    work.run([joined])
    assert work.result(joined) == sum(n * n for n in range(8))
    records = work.records()
    assert len(records) == 9 and {record.kind for record in records} == {"square", "total"}
    assert all(record.seconds >= 0 and record.bytes > 0 for record in records)


@pytest.mark.parametrize("damaged", [False, True], ids=["another's", "damaged"])
def test_a_result_that_is_not_its_own_is_made_again(tmp_path, damaged):
    work, jobs = Work(open_store(tmp_path / "work", lasting=False)), squares(tmp_path, 2)
    work.run(jobs)
    file, other = (tmp_path / "work" / job.entry[:2] / job.entry for job in jobs)
    file.write_bytes(file.read_bytes()[:-1] if damaged else other.read_bytes())
    assert work.result(jobs[0]) == 0 and calls(tmp_path) == {"0": 2, "1": 1}


def test_a_result_that_is_gone_is_one_line(tmp_path):
    lost = Job("total", "", "a" * 64, total, (squares(tmp_path)[3].result,))
    with pytest.raises(WorkError, match="which is gone"):
        perform(open_store(tmp_path / "work"), lost)
    other = Job("square", "", "b" * 64, square, (1, str(tmp_path)), code="another version")
    with pytest.raises(WorkError, match="expected the version of airgs-codec"):
        perform(open_store(tmp_path / "work"), other)


@pytest.mark.parametrize("several", [False, True])
def test_results_that_are_gone_when_others_read_them_are_made_again(tmp_path, processes, several):
    work = Work(open_store(tmp_path / "work"), processes if several else InProcess())
    jobs = squares(tmp_path, 4)
    work.run(jobs)
    joined = [Job("total", "", f"{n:064x}"[::-1], total, (jobs[n].result, jobs[n + 1].result)) for n in (1, 2)]
    for n in (1, 2, 3):
        file = tmp_path / "work" / jobs[n].entry[:2] / jobs[n].entry
        file.write_bytes(file.read_bytes()[:-1])
    work.run(joined)
    assert [work.result(job) for job in joined] == [1 + 4, 4 + 9]


@pytest.mark.parametrize("several", [False, True])
def test_errors_of_jobs_come_whole_and_later_jobs_go_on(tmp_path, processes, several):
    work = Work(open_store(tmp_path / "work"), processes if several else InProcess())
    bad = [Job("refuse", "", f"{n:064x}", refuse, (n,)) for n in (50, 51)]
    with pytest.raises(FormatError, match=r"job 5[01]: expected another number \[bad_value\]") as caught:
        work.run(bad)
    assert caught.value.reason == "bad_value" and caught.value.where.startswith("job 5")
    work.run(squares(tmp_path))
    assert len(calls(tmp_path)) == 8


def test_a_process_that_dies_is_replaced_and_loses_nothing(tmp_path):
    engine = Processes(2)
    try:
        work = Work(open_store(tmp_path / "work"), engine)
        jobs = [*squares(tmp_path, 7), Job("die", "", "d" * 64, die_once, (7, str(tmp_path)))]
        work.run(jobs)
        assert [work.result(job) for job in jobs] == [n * n for n in range(7)] + [7]
        assert set(calls(tmp_path).values()) <= {1, 2}  # what others did when one died may be done again
        with pytest.raises(WorkError, match=f"{DEATHS} workers died in a row, 1 are left"):
            work.run([Job("die", "", "e" * 64, die, (0,))])
    finally:
        engine.close()
