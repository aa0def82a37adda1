"""Programs of a launched simulation: their thread, their output, and how a start fails."""

import threading
import time

import numpy as np
import pytest

import zensim
from tests.integration.processes import eventually
from zensim.proto.messages.standard_messages import LaserScan

SLACK_S = 20.0
"""Of wall times on a machine with other work."""


def test_server_outlives_the_thread_that_launched_it(capfd: pytest.CaptureFixture[str]) -> None:
    launched: list[zensim.Sim] = []
    starter = threading.Thread(target=lambda: launched.append(zensim.launch(timeout_s=120.0)))
    starter.start()
    starter.join()
    with launched[0] as sim:
        robot = sim.spawn("box_bot", name="r1")
        robot.drive(0.2)
        sim.run_for(1.0)
        assert robot.pose.x > 0.1

    assert capfd.readouterr() == ("", "")


def test_failed_start_says_why_and_prints_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(zensim.Error) as caught:
        zensim.launch("no_such_world", timeout_s=120.0)

    assert caught.value.slug == "launch_failed"
    assert "no_such_world" in caught.value.message
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_start_that_takes_too_long_ends_at_its_timeout() -> None:
    threads = threading.active_count()
    began_s = time.monotonic()

    with pytest.raises(zensim.Error):
        zensim.launch(timeout_s=0.05)

    assert time.monotonic() - began_s < 2.0 + SLACK_S
    eventually(lambda: threading.active_count() <= threads, 5.0)


def run_scan_loop(sim: zensim.Sim) -> tuple[list[float], str]:
    """Turn away from walls by the scans; return the nearest distance of each, and the hash."""
    sim.reset()
    robot = sim.spawn("box_bot_lidar", name="r1")
    nearest: list[float] = []

    @robot.on("scan", queue=100)
    def avoid(scan: LaserScan) -> None:
        ranges = np.asarray(scan.ranges)
        nearest.append(float(ranges.min()))
        robot.drive(0.3, 0.0 if ranges[150:210].min() > 1.0 else 0.8)

    sim.run_for(3.0)
    avoid.cancel()
    return nearest, sim.state_hash()


def test_loop_on_scans_is_the_same_in_each_run() -> None:
    with zensim.launch("walls", seed=1, timeout_s=120.0) as sim:
        # The first run has to start the sensor process.
        first = run_scan_loop(sim)
        assert len(first[0]) == 30
        assert run_scan_loop(sim) == first
