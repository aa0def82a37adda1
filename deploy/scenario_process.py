"""The process that runs one scenario: a request on stdin, its report on stdout."""

import os
import sys
import traceback
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import msgspec

import zensim
from zensim.api.connections import launch_configured
from zensim.api.local_deployment import LaunchConfig
from zensim.api.simulation import Simulation
from zensim.deploy.scenario_settings import add_scenario
from zensim.proto.child_process import (
    SINGLE_THREADED,
    make_module_command,
    reserve_stdout,
    run_process,
)
from zensim.proto.endpoints import with_free_port
from zensim.proto.process_limits import die_with_parent
from zensim.proto.ros2.ros_settings import NO_ROS
from zensim.scenario.scenario_loading import open_world
from zensim.scenario.scenario_nodes import ScenarioInvalid
from zensim.scenario.scenario_reader import Scenario, read_scenario
from zensim.scenario.scenario_runner import RunReport, ScenarioFailed, run_scenario

RUN_COMMAND = make_module_command("zensim.deploy.scenario_process")
SETTINGS_OF_UP = ("listen", "connect", "wait", "journal", "viewer", "rtf", "lockstep")
"""Options whose keys do not count in tests."""


class RunRequest(msgspec.Struct, frozen=True):
    """A scenario to run."""

    file: str
    settings: tuple[str, ...] = ()
    allows_python: bool = True
    is_served: bool = False
    """By a server process of its own, instead of in process."""
    timeout_s: float = 600.0
    """Wall time."""

    @property
    def repeat(self) -> str:
        """Command line that repeats the run."""
        words = [f"--set {setting}" for setting in self.settings]
        return " ".join(["zensim test", self.file, *words, *(["--server"] * self.is_served)])


def run_request(request: RunRequest) -> RunReport:
    """Run a scenario in this process; an error of any kind is part of the report."""
    try:
        scenario = read_scenario(request.file, request.settings)
    except ScenarioInvalid as error:
        return RunReport(request.file, request.file, 0, "", error=str(error))
    try:
        return _run(scenario, request)
    except Exception as error:  # noqa: BLE001  the world's and the author's, whatever they are
        return _make_failed_report(scenario, request, _describe(error))


def _run(scenario: Scenario, request: RunRequest) -> RunReport:
    with _open_world(scenario, request) as sim:
        return run_scenario(
            scenario, sim, allows_python=request.allows_python, repeat=request.repeat
        )


def _open_world(scenario: Scenario, request: RunRequest) -> Simulation:
    """Load the world of a scenario, in this process or in a server of its own."""
    if request.is_served:
        return launch_configured(make_launch_config(scenario))
    return open_world(scenario)


def make_launch_config(scenario: Scenario) -> LaunchConfig:
    """Configure a paused server of its own with its agents, and sensor processes if wanted."""
    base = LaunchConfig(world="empty", endpoint=with_free_port("tcp/127.0.0.1:0"), ros=NO_ROS)
    return msgspec.structs.replace(
        add_scenario(base, scenario, dict.fromkeys(SETTINGS_OF_UP)), is_paused=True, ros=NO_ROS
    )


def _describe(error: Exception) -> str:
    """Describe an error, with the line of the author's code that raised it."""
    failure = f"{type(error).__name__}: {error}"
    if isinstance(error, ScenarioFailed):
        return str(error)
    package = str(Path(zensim.__file__).parent)
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if not frame.filename.startswith(package)]
    return f"{failure} ({own[-1].filename}:{own[-1].lineno})" if own else failure


def _make_failed_report(scenario: Scenario, request: RunRequest, error: str) -> RunReport:
    return RunReport(
        scenario.name,
        scenario.file,
        scenario.seed,
        scenario.sha256,
        robots=len(scenario.robots),
        error=error,
        repeat=request.repeat,
    )


def run_in_process(request: RunRequest) -> RunReport:
    """Run a scenario in a process of its own, which is killed at the timeout."""
    outcome = run_process(
        RUN_COMMAND,
        msgspec.msgpack.encode(request),
        timeout_s=request.timeout_s,
        environment=SINGLE_THREADED,
    )
    if not outcome.is_out_of_time and not outcome.status:
        return msgspec.msgpack.decode(outcome.output, type=RunReport)
    failure = f"its process ended with status {outcome.status}"
    if outcome.is_out_of_time:
        failure = f"timeout: not over after {request.timeout_s:g} s of wall time"
    return _make_failed_report(read_scenario(request.file, request.settings), request, failure)


def run_all(
    requests: Sequence[RunRequest], *, jobs: int, on_run: Callable[[RunReport], None]
) -> list[RunReport]:
    """Run scenarios, several at once; reports are in the order of the requests.

    Args:
        requests: Scenarios without mistakes.
        jobs: Number at once.
        on_run: Called in order, as soon as possible.
    """
    runs = []
    with ThreadPoolExecutor(jobs) as pool:
        outcomes = [pool.submit(run_in_process, one) for one in requests]
        try:
            for outcome in outcomes:
                runs.append(outcome.result())
                on_run(runs[-1])
        finally:
            pool.shutdown(cancel_futures=True)
    return runs


def main() -> None:
    """Run the scenario of the request on stdin."""
    die_with_parent()
    replies = reserve_stdout()
    request = msgspec.msgpack.decode(sys.stdin.buffer.read(), type=RunRequest)
    report = run_request(request)
    with os.fdopen(replies, "wb") as stream:
        stream.write(msgspec.msgpack.encode(report))


if __name__ == "__main__":
    main()
