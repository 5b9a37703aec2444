"""Workers that die, with real processes: the tasks are numbers of signals, which `raise_signal` sends to its own."""

import signal
import sys
from concurrent.futures import wait
from types import SimpleNamespace

import pytest

from wayside.pipeline.fleet.engine import DaskEngine, ProcessEngine, WorkerDeathError
from wayside.schemas.errors import OutputError, UsageError


def ended(engine, *tasks):
    """What became of tasks that are begun together: results or deaths."""
    futures = [engine.submit(task) for task in tasks]
    assert not wait(futures, 60.0).not_done
    return [outcome(engine, future) for future in futures]


def outcome(engine, future):
    try:
        return engine.result(future)
    except WorkerDeathError as death:
        return str(death)


def test_a_dead_worker_takes_only_its_own_task_along_and_is_replaced():
    with ProcessEngine(signal.raise_signal, jobs=2) as engine:
        assert engine.places() == 2
        assert ended(engine, signal.SIGKILL, 0) == ["its worker was killed by SIGKILL", None]
        assert ended(engine, 0, signal.SIGTERM) == [None, "its worker was told to stop"]
        with pytest.raises((OSError, ValueError)):  # no such signal: what a task raises comes here
            ended(engine, 0, -1)


def test_leaving_ends_what_is_under_way():
    with ProcessEngine(signal.sigwait, jobs=1) as engine:
        engine.submit({signal.SIGUSR1})  # it would wait for ever
        workers = list(engine.workers)
    assert len(workers) == 1
    assert not any(worker.is_alive() for worker in workers)


@pytest.mark.slow
def test_on_dask_a_task_that_kills_its_workers_is_told_and_the_others_are_done(tmp_path):
    pytest.importorskip("distributed")
    shared = tmp_path / "fleet.json"
    with pytest.raises(OutputError, match="do not see this folder"):
        DaskEngine(signal.raise_signal, "local", 1, shared)
    shared.touch()
    with DaskEngine(signal.raise_signal, "local", 2, shared) as engine:
        assert engine.places() == 2
        done, killed = ended(engine, 0, int(signal.SIGKILL))
    assert done is None
    assert "died" in killed


def test_a_cluster_that_fails_to_stop_its_workers_does_not_fail_the_fleet(tmp_path, monkeypatch):
    def fail():
        raise AssertionError("can only join a started process")  # as Dask of one that restarts

    cluster = SimpleNamespace(close=fail)
    client = SimpleNamespace(
        close=lambda: None,
        get_executor=lambda **_: SimpleNamespace(shutdown=lambda wait: None),
        run=lambda *_: {},
        wait_for_workers=lambda *_, **__: None,
    )
    made = {"LocalCluster": lambda **_: cluster, "Client": lambda *_, **__: client}
    monkeypatch.setitem(sys.modules, "distributed", SimpleNamespace(**made))
    with DaskEngine(signal.raise_signal, "local", 1, tmp_path):
        pass


@pytest.mark.slow
def test_a_scheduler_that_is_not_there_is_told(tmp_path, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("wayside.pipeline.fleet.engine._CONNECT_S", 0.2)
    with pytest.raises(UsageError, match="no Dask scheduler"):
        DaskEngine(signal.raise_signal, "tcp://127.0.0.1:9", None, tmp_path)
