"""`ogm build --dask`: the same tasks on a Dask cluster, here one of two processes, make the same files."""

import gzip
import os
from pathlib import Path

import pytest

from dying_tasks import task
from ogm_core.errors import BadInput, BadRecording
from ogm_services.commands.batch import dask_workers
from ogm_services.commands.batch.dask_workers import ClusterFailed, DaskWorkers
from ogm_services.commands.batch.workers import WorkerDied
from ogm_services.commands.build import run_build
from ogm_services.commands.build_request import BuildRequest
from ogm_services.commands.log_readers import ReadAs
from ogm_services.runtime.kernel_cache import kernel_cache
from ogm_services.settings.sources import load_settings
from rough_log import write_three_logs

dask = pytest.importorskip("dask", reason="dask, the extra dask, is not installed")
distributed = pytest.importorskip("distributed", reason="distributed, the extra dask, is not installed")
pytestmark = pytest.mark.filterwarnings("ignore:.*unclosed:pytest.PytestUnraisableExceptionWarning")
"""Dask leaves a socket of its dashboard open."""
DATASETS = os.environ.get("OGM_DATASETS")
FILES = ("map.npz", "map.png", "map.pgm", "map.yaml", "quality.json", "logs.json")


@pytest.fixture(scope="module")
def scheduler():
    """The address of a scheduler with two workers; they take seconds to start."""
    with (
        kernel_cache(),
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=":0", host="127.0.0.1"
        ) as cluster,
    ):
        yield cluster.scheduler_address


def equal_files(logs, folder, settings, scheduler, **options):
    for name, more in (("alone", {}), ("cluster", {"dask": scheduler})):
        run_build(BuildRequest(logs, folder / name, settings, **options, **more))
    for name in FILES:
        assert (folder / "cluster" / name).read_bytes() == (folder / "alone" / name).read_bytes(), name
    return folder / "cluster"


def test_a_cluster_makes_the_same_files(tmp_path, scheduler):
    settings = load_settings(config=None, flags={"map": {"half_life": 5.0}}, environ={})
    equal_files(write_three_logs(tmp_path), tmp_path, settings, scheduler)
    assert not list(tmp_path.glob(".ogm-build-*"))


@pytest.mark.skipif(DATASETS is None, reason="OGM_DATASETS does not name the folder of recorded logs")
def test_a_cluster_maps_a_recorded_building_in_eight_parts(tmp_path, scheduler):
    """4791 scans, which takes some seconds: a log that is cut where a day might end."""
    packed = Path(DATASETS, "freiburg-079", "freiburg-079-corrected.log.gz")
    lines = gzip.decompress(packed.read_bytes()).splitlines(keepends=True)
    logs = [tmp_path / f"part{number}.log" for number in range(8)]
    for number, log in enumerate(logs):
        log.write_bytes(b"".join(lines[len(lines) * number // 8 : len(lines) * (number + 1) // 8]))
    settings = load_settings(config=None, flags={"map": {"clear_range": 25.0}}, environ={})
    equal_files(logs, tmp_path, settings, scheduler, read_as=ReadAs(80.0))


def test_what_goes_wrong_at_a_worker_is_told(tmp_path, scheduler, monkeypatch):
    with pytest.raises(BadRecording, match=r"^a\.log: holds no scan$"), DaskWorkers(scheduler) as workers:
        workers.run("working", [task("failing", "a.log: holds no scan")])
    late = task("failing_after", tmp_path / "failed", "b.log: holds no scan")
    soon = task("failing", "c.log: holds no scan", tmp_path / "failed")
    with pytest.raises(BadRecording, match=r"^b\.log: "), DaskWorkers(scheduler) as workers:
        workers.run("working", [late, soon])
    with DaskWorkers(scheduler) as workers:
        assert workers.count == 2
        assert workers.run("working", [task("dying", tmp_path, n, 0) for n in range(5)]) == [
            (n, 1) for n in range(5)
        ]
        monkeypatch.setattr(dask_workers, "name_of_sources", lambda: "ogm-others")
        with pytest.raises(BadInput, match="--dask: a worker has another version of zenoh-ogm"):
            workers.run("working", [task("dying", tmp_path, 9, 0)])


def test_a_dead_workers_task_is_done_again_and_one_that_all_die_of_is_named(tmp_path, scheduler):
    with DaskWorkers(scheduler) as workers:
        assert workers.run("working", [task("dying", tmp_path, 1, 1)]) == [(1, 2)]
        with pytest.raises(WorkerDied, match=r"^log 2: 3 workers of --dask have died of it"):
            workers.run("working", [task("dying", tmp_path, 2, 99, about="log 2")])


def test_an_address_where_nobody_is_and_a_scheduler_without_workers_are_refused(monkeypatch):
    monkeypatch.setattr(distributed, "Client", None)  # which would try for 30 s
    why = r"^--dask tcp://127\.0\.0\.1:9: no scheduler answers there: .*Connection refused"
    with pytest.raises(BadInput, match=why):
        DaskWorkers("tcp://127.0.0.1:9")
    with pytest.raises(BadInput, match=r"^--dask nonsense://x: no scheduler answers there: "):
        DaskWorkers("nonsense://x")
    with pytest.raises(BadInput, match=r"^--dask host: no scheduler answers there: missing port number "):
        DaskWorkers("host")
    monkeypatch.undo()
    idle = distributed.LocalCluster(n_workers=0, dashboard_address=":0", host="127.0.0.1")
    with idle, pytest.raises(BadInput, match=r"the scheduler has no worker: start some, then build$"):
        DaskWorkers(idle.scheduler_address)


def one_worker(**options):
    """A cluster of one worker."""
    return distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address=":0", host="127.0.0.1", **options
    )


def test_workers_that_are_paused_end_the_build_with_what_to_do(monkeypatch, eventually):
    monkeypatch.setattr(dask_workers, "STALLED_FOR", 1.0)
    monkeypatch.setattr(dask_workers, "LOOKED_AT", 0.1)
    limits = {f"distributed.worker.memory.{what}": False for what in ("target", "spill", "terminate")}
    with dask.config.set(limits), one_worker(memory_limit="1MB") as cluster:
        address = cluster.scheduler_address
        with distributed.Client(address, set_as_default=False) as client:
            eventually(lambda: [one["status"] for one in workers_of(client)] == ["paused"])
            refused(address, "1 of 1 workers are paused, as they use most of the memory that they may: give")


def workers_of(client):
    return client.scheduler_info(n_workers=-1)["workers"].values()


def refused(address, why):
    """Nobody does a task, and the build ends by this."""
    with (
        pytest.raises(ClusterFailed, match=f"^--dask {address}: {why}"),
        DaskWorkers(address) as workers,
    ):
        workers.run("working", [task("endless")])


def test_workers_that_are_gone_and_a_scheduler_that_goes_end_the_build(monkeypatch, eventually):
    monkeypatch.setattr(dask_workers, "STALLED_FOR", 1.0)
    monkeypatch.setattr(dask_workers, "LOOKED_AT", 0.1)
    with one_worker() as cluster, DaskWorkers(cluster.scheduler_address) as workers:
        at_work = workers._at_work
        monkeypatch.setattr(workers, "_at_work", lambda: at_work() and cluster.close() is None)
        with pytest.raises(ClusterFailed, match=r"the scheduler is gone: start it, then build again$"):
            workers.run("working", [task("endless")])
        workers._executor.shutdown(wait=False)
    with one_worker() as cluster, DaskWorkers(cluster.scheduler_address) as workers:
        cluster.scale(0)
        eventually(lambda: not workers._workers())
        why = "it has had no worker for 1 s: start some, then build again; if they ended at the first task, "
        with pytest.raises(
            ClusterFailed, match=f"^--dask {cluster.scheduler_address}: {why}zenoh-ogm is not "
        ):
            workers.run("working", [task("endless")])
        workers._executor.shutdown(wait=False)
