"""A Dask cluster of this machine: the same results, one worker dying on the way."""

import logging
from types import SimpleNamespace

import pytest

from airgs_codec.jobs.dask_engine import DaskEngine
from tests.faces import FormatError, Job, Work, WorkError, open_store
from tests.support.jobs import die, die_once, refuse, square


@pytest.fixture(scope="module")
def engine():
    cluster = DaskEngine.local(2)
    yield cluster
    cluster.close()


def test_a_worker_that_dies_loses_nothing(tmp_path, engine):
    work = Work(open_store(tmp_path / "work"), engine)
    jobs = [Job("square", "", f"{n:064x}", square, (n, str(tmp_path))) for n in range(7)]
    jobs.insert(3, Job("die", "", "d" * 64, die_once, (7, str(tmp_path))))
    work.run(jobs)
    assert sorted(work.result(job) for job in jobs) == sorted([0, 1, 4, 9, 16, 25, 36, 7])
    assert len({record.worker for record in work.records()}) >= 2


def test_errors_come_whole_and_a_job_that_kills_its_workers_is_given_up(tmp_path, engine):
    work = Work(open_store(tmp_path / "work"), engine)
    with pytest.raises(FormatError, match="expected another number") as caught:
        work.run([Job("refuse", "", "a" * 64, refuse, (3,))])
    assert caught.value.reason == "bad_value"
    with pytest.raises(WorkError, match="workers died of one job"):
        work.run([Job("die", "", "b" * 64, die, (0,))])


def test_a_scheduler_that_nobody_runs_is_one_line(monkeypatch):
    monkeypatch.setattr("airgs_codec.jobs.dask_engine.CONNECT_S", 1)
    with pytest.raises(WorkError, match=r"--executor dask:tcp://127\.0\.0\.1:9"):
        DaskEngine.at("tcp://127.0.0.1:9")


def test_a_cluster_that_ends_says_nothing(capfd):
    """The nanny of a process that is slow to end has to kill it, and would say so."""
    nanny = SimpleNamespace(close=lambda: logging.getLogger("distributed.nanny").warning("still alive, killing"))
    DaskEngine(SimpleNamespace(close=lambda: None), nanny).close()
    assert capfd.readouterr().err == ""
