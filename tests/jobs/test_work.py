"""Work is done once, whoever does it; what dies, is damaged or comes in another order changes nothing."""

import logging
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from types import SimpleNamespace

import dask
import pytest
from dask.distributed import default_client

from airgs_codec.jobs import executors
from tests.faces import DaskCluster, FormatError, Processes, Work, WorkError, open_store
from tests.support.jobs import calls, die, refuse, square

EXECUTORS = {
    "here": lambda: None, "threads": partial(ThreadPoolExecutor, 2), "processes": partial(Processes, 2),
    "dask": partial(DaskCluster, count=2, needs={"FPGA": 1}),
}  # fmt: skip


@pytest.fixture(scope="module", params=EXECUTORS)
def executor(request):
    with dask.config.set({"distributed.worker.resources": {"GPU": 1}}):
        made = EXECUTORS[request.param]()
    yield made
    if made:
        made.shutdown(cancel_futures=True)


@pytest.fixture
def work(executor, tmp_path):
    return Work(executor, open_store(tmp_path / "work"))


def squares(work, folder, count=8, version=0):
    return work.results("squares", square, [(n, str(folder)) for n in range(count)], range(count), version)


def test_calls_are_done_once_and_their_results_are_read_by_others(tmp_path, work):
    seen = []
    assert squares(replace(work, progress=lambda *words: seen.append(words)), tmp_path, 5) == [0, 1, 4, 9, 16]
    assert seen == [("squares", done, 5) for done in range(1, 6)]
    assert squares(work, tmp_path) == squares(work, tmp_path) == [n * n for n in range(8)]
    assert calls(tmp_path) == {str(n): 1 for n in range(8)}
    squares(work, tmp_path, 1, version=1)  # the function gives something else now
    assert work.results("squares", square, [(1, str(tmp_path))]) == [1]  # nobody says what decides it
    assert calls(tmp_path) == {str(n): 1 + (n < 2) for n in range(8)}


def test_errors_of_calls_come_whole_and_later_calls_go_on(tmp_path, work):
    with pytest.raises(FormatError, match=r"job 5[01]: expected another number \[bad_value\]") as caught:
        work.results("refused", refuse, [(50,), (51,)], [50, 51])
    assert caught.value.reason == "bad_value" and caught.value.where.startswith("job 5")
    assert len(squares(work, tmp_path)) == len(calls(tmp_path)) == 8


@pytest.mark.parametrize(("executor", "message"), [
    ("processes", "3 workers died in a row: is there memory for 2"), ("dask", "3 workers died of one job"),
], indirect=["executor"])  # fmt: skip
def test_a_worker_that_dies_is_replaced_and_loses_nothing(tmp_path, work, message):
    asked = [(n, str(tmp_path), (3,)) for n in range(8)]
    assert work.results("squares", square, asked, asked) == [n * n for n in range(8)]
    assert set(calls(tmp_path).values()) <= {1, 2}  # what others did when one died may be done again
    with pytest.raises(WorkError, match=message):
        work.results("deaths", die, [()])
    assert squares(work, tmp_path, 2) == [0, 1]


def test_deaths_of_workers_count_only_in_a_row(tmp_path, monkeypatch):
    monkeypatch.setattr(executors, "DEATHS", 2)
    with Processes(1) as pool:
        asked = [(n, str(tmp_path), (1, 3, 5)) for n in range(6)]
        assert Work(pool).results("squares", square, asked) == [n * n for n in range(6)]


def test_a_pool_that_breaks_is_one_line():
    with ProcessPoolExecutor(1, get_context("spawn")) as pool, pytest.raises(WorkError, match="is there memory"):
        Work(pool).results("deaths", die, [()])


def test_a_result_that_is_damaged_or_not_its_own_is_made_again(tmp_path):
    work = Work(None, open_store(tmp_path / "work"))
    squares(work, tmp_path, 1)
    [file] = (path for path in (tmp_path / "work").rglob("*") if path.is_file())
    squares(work, tmp_path, 2)
    [other] = (path for path in (tmp_path / "work").rglob("*") if path.is_file() and path != file)
    for count, data in ((2, file.read_bytes()[:-1]), (3, other.read_bytes())):
        file.write_bytes(data)
        assert squares(work, tmp_path, 2) == [0, 1] and calls(tmp_path) == {"0": count, "1": 1}


@pytest.mark.parametrize("executor", ["dask"], indirect=True)
def test_calls_go_to_workers_that_have_what_they_need(tmp_path, work, monkeypatch):
    """Workers that others run are asked for it; those of a cluster made here have all of this machine."""
    monkeypatch.setattr(executors, "WORKER_S", 0.5)
    address = default_client().scheduler.address
    with DaskCluster(address, needs={"GPU": 1}) as shared:
        assert squares(replace(work, executor=shared), tmp_path, 2) == [0, 1]
    with pytest.raises(WorkError, match="a worker started with --resources 'FPGA=1', got 2 without"):
        DaskCluster(address, needs={"FPGA": 1})
    assert squares(work, tmp_path, 3) == [0, 1, 4]


def test_a_scheduler_that_nobody_runs_is_one_line(monkeypatch):
    monkeypatch.setattr(executors, "CONNECT_S", 1)
    with pytest.raises(WorkError, match=r"--executor dask:tcp://127\.0\.0\.1:9"):
        DaskCluster("tcp://127.0.0.1:9")


def test_a_cluster_that_ends_says_nothing(capfd):
    """The nanny of a process that is slow to end has to kill it, and would say so."""
    cluster = object.__new__(DaskCluster)
    cluster._client = SimpleNamespace(close=lambda: None)
    cluster._cluster = SimpleNamespace(close=lambda: logging.getLogger("distributed.nanny").warning("killing"))
    cluster.shutdown()
    assert capfd.readouterr().err == ""
