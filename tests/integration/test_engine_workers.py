"""A server with worker processes: they start and exit together."""

import os
import signal
from collections.abc import Iterator

import psutil
import pytest

from tests.integration.processes import END_S, Server, eventually, running_agents, serving
from tests.integration.robots import robot
from zensim.sim_server.physics.engine_factory import MAX_CELL_BODIES

FLEET = MAX_CELL_BODIES["pybullet"] + 6


@pytest.fixture
def server() -> Iterator[Server]:
    options = ("--clusters", "on", "--engine-workers", "1", "--rtf", "0", "--step-hz", "100")
    with serving(*options) as found:
        layout = ("--robots", str(FLEET), "--layout", "grid", "--spacing", "2")
        done = found.zensim("fleet", "box_bot", *layout)
        assert done.returncode == 0, done.stderr
        yield found


def worker_pids(server: Server) -> list[psutil.Process]:
    return [
        child
        for child in psutil.Process(server.process.pid).children()
        if "zensim.sim_server.physics.cell_worker" in child.cmdline()
    ]


def test_robots_drive_in_each_process_until_the_server_is_stopped(server: Server) -> None:
    names = ("box_bot0", f"box_bot{FLEET - 1}")
    with running_agents(server, *names):
        robots = [robot(server.bus, name) for name in names]
        starts = [found.now().pose.pose.position.x for found in robots]

        def all_moved() -> bool:
            for found in robots:
                found.command(0.3)
            return all(
                abs(found.now().pose.pose.position.x - start) > 0.2
                for found, start in zip(robots, starts, strict=True)
            )

        eventually(all_moved, 30.0, "driving")

    (worker,) = worker_pids(server)
    server.process.send_signal(signal.SIGINT)
    assert server.process.wait(END_S) == 0
    assert not worker.is_running()


def test_worker_exits_when_its_server_is_killed(server: Server) -> None:
    (worker,) = worker_pids(server)

    os.kill(server.process.pid, signal.SIGKILL)

    eventually(lambda: not worker.is_running(), 5.0, "the end of the worker")


def test_server_exits_when_a_worker_is_killed(server: Server) -> None:
    (worker,) = worker_pids(server)

    worker.kill()

    assert eventually(server.process.poll, 10.0, "the end of the server") != 0
    assert server.process.stderr is not None
    assert "worker 1" in server.process.stderr.read()
