"""Jobs are done once, whoever does them; what dies, is damaged or comes in another order changes nothing."""

import logging
from contextlib import closing
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import dask
import pytest
from dask.distributed import default_client

from airgs_codec.jobs import dask_engine
from tests.faces import FormatError, InProcess, Job, Processes, Work, WorkError, open_store
from tests.support.jobs import calls, die, die_once, refuse, square, total

ENGINES = {"here": InProcess, "processes": partial(Processes, 2), "dask": partial(dask_engine.DaskEngine.local, 2)}


@pytest.fixture(scope="module", params=ENGINES)
def engine(request):
    with dask.config.set({"distributed.worker.resources": {"GPU": 1}}):
        made = ENGINES[request.param]()
    yield made
    made.close()


@pytest.fixture
def work(engine, tmp_path):
    return Work(open_store(tmp_path / "work"), engine)


def squares(folder, count=8):
    return [Job("square", f"number {n}", f"{n:064x}", square, (n, str(folder))) for n in range(count)]


def file_of(folder, job):
    return folder / "work" / job.entry[:2] / job.entry


def test_jobs_are_done_once_and_their_results_are_read_by_others(tmp_path, work):
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


def test_results_that_are_gone_when_others_read_them_are_made_again(tmp_path, work):
    jobs = squares(tmp_path, 4)
    work.run(jobs)
    joined = [Job("total", "", f"{n:064x}"[::-1], total, (jobs[n].result, jobs[n + 1].result)) for n in (1, 2)]
    for job in jobs[1:]:
        file = file_of(tmp_path, job)
        file.write_bytes(file.read_bytes()[:-1])
    work.run(joined)
    assert [work.result(job) for job in joined] == [1 + 4, 4 + 9]


def test_errors_of_jobs_come_whole_and_later_jobs_go_on(tmp_path, work):
    bad = [Job("refuse", "", f"{n:064x}", refuse, (n,)) for n in (50, 51)]
    with pytest.raises(FormatError, match=r"job 5[01]: expected another number \[bad_value\]") as caught:
        work.run(bad)
    assert caught.value.reason == "bad_value" and caught.value.where.startswith("job 5")
    work.run(squares(tmp_path))
    assert len(calls(tmp_path)) == 8


@pytest.mark.parametrize(("engine", "message"), [
    ("processes", "3 workers died in a row, 1 are left"), ("dask", "3 workers died of one job"),
], indirect=["engine"])  # fmt: skip
def test_a_worker_that_dies_is_replaced_and_loses_nothing(tmp_path, work, message):
    jobs = squares(tmp_path, 7)
    jobs.insert(3, Job("die", "", "d" * 64, die_once, (7, str(tmp_path))))
    work.run(jobs)
    assert [work.result(job) for job in jobs] == [0, 1, 4, 7, 9, 16, 25, 36]
    assert set(calls(tmp_path).values()) <= {1, 2}  # what others did when one died may be done again
    assert len({record.worker for record in work.records()}) >= 2
    with pytest.raises(WorkError, match=message):
        work.run([Job("die", "", "e" * 64, die, (0,))])


def test_a_result_that_is_damaged_or_not_its_own_is_made_again(tmp_path):
    work, jobs = Work(open_store(tmp_path / "work", lasting=False)), squares(tmp_path, 2)
    work.run(jobs)
    file, other = (file_of(tmp_path, job) for job in jobs)
    for count, data in ((2, file.read_bytes()[:-1]), (3, other.read_bytes())):
        file.write_bytes(data)
        assert work.result(jobs[0]) == 0 and calls(tmp_path) == {"0": count, "1": 1}


def test_a_result_that_is_gone_is_one_line(tmp_path):
    lost = Job("total", "", "a" * 64, total, (squares(tmp_path)[3].result,))
    other = Job("square", "", "b" * 64, square, (1, str(tmp_path)), code="another version")
    for job, message in ((lost, "which is gone"), (other, "expected the version of airgs-codec")):
        with pytest.raises(WorkError, match=message):
            Work(open_store(tmp_path / "work")).run([job])


@pytest.mark.parametrize("engine", ["dask"], indirect=True)
def test_jobs_go_to_workers_that_have_what_they_need(tmp_path, work, monkeypatch):
    """Workers that others run are asked for it, and those of an engine of its own have all of this machine."""
    monkeypatch.setattr(dask_engine, "WORKER_S", 0.5)
    on_gpu, on_fpga = (Job("square", "", n * 20, square, (3, str(tmp_path)), needs={n: 1}) for n in ("GPU", "FPGA"))
    with closing(dask_engine.DaskEngine.at(default_client().scheduler.address)) as shared:
        theirs = replace(work, engine=shared)
        theirs.run([on_gpu])
        assert theirs.result(on_gpu) == 9
        with pytest.raises(WorkError, match="a worker started with --resources 'FPGA=1', got 2 without"):
            theirs.run([on_fpga])
    work.run([on_fpga])
    assert calls(tmp_path) == {"3": 2}


def test_a_scheduler_that_nobody_runs_is_one_line(monkeypatch):
    monkeypatch.setattr(dask_engine, "CONNECT_S", 1)
    with pytest.raises(WorkError, match=r"--executor dask:tcp://127\.0\.0\.1:9"):
        dask_engine.DaskEngine.at("tcp://127.0.0.1:9")


def test_a_cluster_that_ends_says_nothing(capfd):
    """The nanny of a process that is slow to end has to kill it, and would say so."""
    nanny = SimpleNamespace(close=lambda: logging.getLogger("distributed.nanny").warning("still alive, killing"))
    dask_engine.DaskEngine(SimpleNamespace(close=lambda: None), nanny).close()
    assert capfd.readouterr().err == ""
