"""A Ray cluster of two nodes on this machine: the same set as ever, whoever is lost."""

from __future__ import annotations

import dataclasses
import os
import signal
import threading
import time
from pathlib import Path

import pytest
import ray
from test_make import contents, lines

from lambent.dataset.check import verify
from lambent.dataset.make import make
from lambent.errors import EngineError


@pytest.fixture(scope="module")
def cluster():
    """Two nodes of one processor each; the driver's own path finds the fake source."""
    from ray.cluster_utils import Cluster

    here = str(Path(__file__).parent)
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [here, before]))
    os.environ["RAY_ENABLE_UV_RUN_RUNTIME_ENV"] = "0"
    nodes = Cluster(
        initialize_head=True,
        head_node_args={"num_cpus": 1, "include_dashboard": False, "object_store_memory": 80 << 20},
    )
    nodes.add_node(num_cpus=1, object_store_memory=80 << 20)
    ray.init(address=nodes.address, log_to_driver=False)
    try:
        yield nodes
    finally:
        ray.shutdown()
        nodes.shutdown()
        if before is None:
            os.environ.pop("PYTHONPATH")
        else:
            os.environ["PYTHONPATH"] = before


def test_no_cluster_at_the_address(recipe, tmp_path):
    with pytest.raises(EngineError, match="no Ray cluster"):
        make(recipe, tmp_path / "set", cluster="127.0.0.1:1")


@pytest.mark.slow
def test_two_nodes_make_the_same_set(recipe, cluster, tmp_path):
    make(recipe, tmp_path / "alone")
    outcome = make(recipe, tmp_path / "cluster", cluster=cluster.address, processes=0)
    assert (outcome.made, outcome.left, outcome.failed) == (13, 0, [])
    assert contents(tmp_path / "cluster") == contents(tmp_path / "alone")
    assert lines(tmp_path / "cluster") == lines(tmp_path / "alone")
    assert outcome.phases["samples"] > 0


@pytest.mark.slow
def test_a_lost_worker_costs_one_item(recipe, cluster, tmp_path):
    """One worker is killed -9 in mid-job: the rest of its scene goes elsewhere, nothing twice."""
    recipe = dataclasses.replace(recipe, source="fake:SlowSource", count=24, clip_count=0)
    make(dataclasses.replace(recipe), tmp_path / "alone")
    folder = tmp_path / "cluster"
    killed: list[int] = []

    def kill() -> None:
        deadline = time.monotonic() + 60
        while not killed and time.monotonic() < deadline:
            if len(list(folder.rglob("*.exr"))) >= 5:
                pids = [int(p.name) for p in Path("/proc").iterdir() if p.name.isdigit()]
                for pid in pids:
                    if b"ray::Renderer" in command_of(pid):
                        os.kill(pid, signal.SIGKILL)
                        killed.append(pid)
                        return
            time.sleep(0.02)

    killer = threading.Thread(target=kill)
    killer.start()
    outcome = make(recipe, folder, cluster=cluster.address, processes=2)
    killer.join()
    assert killed, "no worker was found to kill"
    assert (outcome.made, outcome.left, outcome.failed) == (24, 0, [])
    assert verify(folder).sound
    assert contents(folder) == contents(tmp_path / "alone")


def command_of(pid: int) -> bytes:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return b""
