"""Processes that run scenarios: requests on stdin, their reports on stdout, as frames.

A process imports everything once, and runs scenarios in copies of itself, so that none waits for
imports. Each scenario with code of its author has a copy of its own: no run can change the next
one. Those without share one, whose caches make up for most of what a run costs beside its steps.
"""

import contextlib
import shlex
import signal
import threading
import time
import traceback
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from functools import partial
from importlib import import_module
from pathlib import Path
from queue import SimpleQueue

import msgspec

import zensim
from zensim.api.connections import ANY_PORT, launch_configured
from zensim.api.local_deployment import LaunchConfig
from zensim.api.simulation import Simulation
from zensim.deploy.scenario_settings import add_scenario
from zensim.proto.child_process import (
    CAN_COPY,
    STDIN,
    FramedProcess,
    ProcessOutcome,
    ServingCopy,
    encode_frame,
    make_module_command,
    read_frame,
    reserve_stdout,
    run_in_copy,
    write_frame,
)
from zensim.proto.endpoints import with_free_port
from zensim.proto.parent_death import die_with_parent
from zensim.proto.process_limits import KILLED_STATUS
from zensim.proto.settings.lockstep_settings import PATIENT
from zensim.proto.settings.network_settings import NetworkSettings
from zensim.proto.settings.ros_choice import HIDDEN, NAMESPACED, RosChoice, TfChoice
from zensim.proto.settings.server_settings import ServerSettings
from zensim.proto.settings.setting import change_settings, list_settings
from zensim.scenario.run_host import describe_host
from zensim.scenario.scenario_loading import open_world
from zensim.scenario.scenario_nodes import ScenarioInvalid
from zensim.scenario.scenario_reader import Scenario, read_scenario
from zensim.scenario.scenario_recording import find_recording
from zensim.scenario.scenario_runner import RunReport, ScenarioFailed, run_scenario
from zensim.scenario.scenario_sources import write_setting

RUN_COMMAND = make_module_command("zensim.deploy.scenario_process")
KILLED = (KILLED_STATUS, -signal.SIGTERM)
"""Statuses of processes that others ended, such as a kernel without memory."""
POLL_S = 0.005
SHARE_BEFORE_RECORDING = 1 / 3
"""Share of the timeout within which a failed run is repeated for its recording, more slowly."""
FILE_TIME_ERROR_S = 0.1
"""Wall time by which the time of a file may be early: kernels take it from their last tick."""
NOT_STARTED = 1
"""Status that stands for a process that did not start in time."""
MAX_RUNS_OF_COPY = 100
"""A copy grows by .05 MB a run."""
START_TIMEOUT_S = 600.0
"""Wall time of the imports, which does not count as time of a run."""
SETTINGS_OF_UP = (
    *("listen", "connect", "wait", "journal", "viewer", "rtf", "lockstep"),
    *(one.name for group in (RosChoice, TfChoice) for one in list_settings(group)),
)
"""Options whose keys do not count in tests."""


class RunRequest(msgspec.Struct, frozen=True):
    """A scenario to run."""

    file: str
    settings: tuple[str, ...] = ()
    allows_python: bool = True
    is_served: bool = False
    """Whether a server process of its own runs it, instead of in process."""
    timeout_s: float = 600.0
    """Wall time."""
    has_own_timeout: bool = False
    """Whether the timeout is given beside the scenario, and so is needed to repeat the run."""
    failure_recording: str = ""
    """MCAP file for a run that fails, which runs again for it; empty = none."""
    recorded_topics: tuple[str, ...] = ()

    @property
    def repeat(self) -> str:
        """Command line that repeats the run."""
        words = [word for setting in self.settings for word in ("--set", setting)]
        flags = ["--server"] * self.is_served + ["--no-python"] * (not self.allows_python)
        if self.has_own_timeout:
            flags += ["--timeout", f"{self.timeout_s:g}"]
        return shlex.join(["zensim", "test", self.file, *words, *flags])


def run_request(request: RunRequest) -> RunReport:
    """Run a scenario in this process, and again for its recording if it fails.

    An error of any kind is part of the report.
    """
    began_s = time.monotonic()
    report = run_once(request)
    if not _needs_recording(request, report, time.monotonic() - began_s):
        return report
    return _add_recording(report, run_once(_make_recorded(request)))


def _needs_recording(request: RunRequest, report: RunReport, spent_s: float) -> bool:
    # The timeout is of both runs: the verdict of the first must not be lost.
    has_time = spent_s < request.timeout_s * SHARE_BEFORE_RECORDING
    return bool(request.failure_recording) and has_time and not report.is_passed


def _make_recorded(request: RunRequest) -> RunRequest:
    section = {
        # Words in braces are replaced.
        "to": request.failure_recording.replace("{", "{{").replace("}", "}}"),
        "topics": request.recorded_topics,
    }
    recorded = write_setting("record", section)
    return msgspec.structs.replace(request, settings=(*request.settings, recorded))


def _add_recording(report: RunReport, repeated: RunReport) -> RunReport:
    """Add the recording of a second run to the report of the first."""
    hashes = {report.state_hash, repeated.state_hash} - {""}
    is_other = len(hashes) > 1
    error = "not deterministic: repeated for its recording, it ended in another state"
    return msgspec.structs.replace(
        report, recording=repeated.recording, error=error if is_other else report.error
    )


def run_once(request: RunRequest) -> RunReport:
    """Run a scenario in this process; an error of any kind is part of the report."""
    began_s = time.process_time()
    report = _run(request)
    spent_s = time.process_time() - began_s
    return msgspec.structs.replace(report, cpu_s=spent_s, host=describe_host())


def _run(request: RunRequest) -> RunReport:
    began_s = time.time()
    try:
        scenario = read_scenario(request.file, request.settings)
    except (ScenarioInvalid, OSError) as error:
        return RunReport(request.file, request.file, 0, "", error=str(error))
    try:
        with _open_world(scenario, request) as sim:
            return run_scenario(
                scenario, sim, allows_python=request.allows_python, repeat=request.repeat
            )
    except Exception as error:  # noqa: BLE001  code of the author can raise any, and is a row, too
        return _make_failed_report(scenario, request, _describe(error), began_s)


def _open_world(scenario: Scenario, request: RunRequest) -> Simulation:
    """Load the world of a scenario, in this process or in a server of its own."""
    if request.is_served:
        return launch_configured(make_launch_config(scenario))
    return open_world(scenario)


def make_launch_config(scenario: Scenario) -> LaunchConfig:
    """Configure a paused server of its own with its agents, and sensor processes if wanted."""
    base = LaunchConfig(
        network=NetworkSettings(listen=with_free_port(ANY_PORT)),
        server=ServerSettings(lockstep=PATIENT),  # the scenario may say otherwise
        ros_choice=HIDDEN,
        tf_choice=NAMESPACED,
    )
    config = add_scenario(base, scenario, dict.fromkeys(SETTINGS_OF_UP))
    return change_settings(config, {"paused": True})


def _describe(error: Exception) -> str:
    """Describe an error, with the line of the author's code that raised it."""
    failure = f"{type(error).__name__}: {error}"
    if isinstance(error, ScenarioFailed):
        return str(error)
    # A context manager of ours is left through a frame of contextlib.
    ours = (str(Path(zensim.__file__).parent), contextlib.__file__)
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if not frame.filename.startswith(ours)]
    return f"{failure} ({own[-1].filename}:{own[-1].lineno})" if own else failure


def _make_failed_report(
    scenario: Scenario, request: RunRequest, error: str, began_s: float
) -> RunReport:
    return RunReport(
        scenario.name,
        scenario.file,
        scenario.seed,
        scenario.sha256,
        robots=len(scenario.robots),
        error=error,
        repeat=request.repeat,
        recording=_find_kept_recording(scenario, began_s),
    )


def _find_kept_recording(scenario: Scenario, began_s: float) -> str:
    """Find what was recorded until a run failed, if anything was since it began."""
    path = find_recording(scenario)
    is_own = (
        path is not None and path.exists() and path.stat().st_mtime >= began_s - FILE_TIME_ERROR_S
    )
    return str(path) if is_own else ""


class CopyOutcome(msgspec.Struct, frozen=True):
    """How the copy ended that ran a scenario."""

    status: int
    """Exit status, negative for a signal."""
    report: bytes
    """A `RunReport`; empty if the status is not 0."""


class ScenarioWorker:
    """A process that runs scenarios, one at a time; it is killed at a timeout, and replaced."""

    def __init__(self) -> None:
        self._process: FramedProcess | None = None
        self._is_stopped = threading.Event()

    def run(self, request: RunRequest, attempts: int = 1) -> RunReport:
        """Run a scenario; whatever happens to the process is part of the report.

        Args:
            request: The scenario.
            attempts: Most runs of it, while its process is killed by others.
        """
        began_s = time.time()
        for _ in range(attempts):
            outcome = self._run_once(request)
            if outcome is None or outcome.status not in KILLED:
                break
        return _make_report(request, outcome, began_s)

    def _run_once(self, request: RunRequest) -> CopyOutcome | None:
        """Run a scenario; None at the timeout."""
        if self._process is None or self._process.poll() is not None:
            self._process = FramedProcess(RUN_COMMAND, stderr=None)
            # A late first frame would pass for the outcome.
            found = self._await_frame(self._process, time.monotonic() + START_TIMEOUT_S)
            if not isinstance(found, bytes):
                self.close()
                return CopyOutcome(found or NOT_STARTED, b"")
        self._process.send([encode_frame(msgspec.msgpack.encode(request))])
        found = self._await_frame(self._process, time.monotonic() + request.timeout_s)
        if found is None or not CAN_COPY:
            self.close()
        if isinstance(found, bytes):
            return msgspec.msgpack.decode(found, type=CopyOutcome)
        return None if found is None else CopyOutcome(found, b"")

    def stop(self) -> None:
        """Let the present run end at once, from another thread; close the worker after that."""
        self._is_stopped.set()

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None

    def _await_frame(self, process: FramedProcess, deadline_s: float) -> bytes | int | None:
        """Wait for a frame; return the exit status if the process ends, None at the deadline."""
        while time.monotonic() < deadline_s:
            status = process.poll()
            process.flush()
            if frames := process.receive():
                return frames[0]
            if status is not None:
                return status
            if self._is_stopped.wait(POLL_S):
                break
        return None


def _make_report(request: RunRequest, outcome: CopyOutcome | None, began_s: float) -> RunReport:
    if outcome is None:
        failure = f"timeout: not over after {request.timeout_s:g} s of wall time"
    elif outcome.status or not outcome.report:
        failure = f"its process ended with status {outcome.status}"
    else:
        return msgspec.msgpack.decode(outcome.report, type=RunReport)
    return make_error_report(request, failure, began_s)


def make_error_report(request: RunRequest, error: str, began_s: float) -> RunReport:
    """Make the report of a run that did not end, and of which nothing else is known.

    Args:
        request: The run.
        error: Why it did not end.
        began_s: Wall time since the epoch when it began.
    """
    scenario = read_scenario(request.file, request.settings)
    return _make_failed_report(scenario, request, error, began_s)


def run_all(
    requests: Sequence[RunRequest], *, jobs: int, on_run: Callable[[RunReport], None]
) -> list[RunReport]:
    """Run scenarios, several at once; reports are in the order of the requests.

    Args:
        requests: Scenarios without mistakes.
        jobs: Number at once.
        on_run: Called in order, as soon as possible.
    """
    runs: list[RunReport] = []
    early: dict[int, RunReport] = {}
    with contextlib.closing(run_in_processes(requests, jobs=jobs)) as ended:
        for number, report in ended:
            early[number] = report
            while len(runs) in early:
                runs.append(early.pop(len(runs)))
                on_run(runs[-1])
    return runs


def run_in_processes(
    requests: Sequence[RunRequest], *, jobs: int, attempts: int = 1
) -> Generator[tuple[int, RunReport], None, None]:
    """Run scenarios, several at once; each report comes when its run has ended.

    Args:
        requests: Scenarios without mistakes.
        jobs: Number at once.
        attempts: Most runs of each, while its process is killed by others.

    Yields:
        Number of the request, and its report. Closing ends the processes at once.
    """
    workers = [ScenarioWorker() for _ in range(min(jobs, len(requests)))]
    free: SimpleQueue[ScenarioWorker] = SimpleQueue()
    for worker in workers:
        free.put(worker)

    def run(request: RunRequest) -> RunReport:
        worker = free.get()
        try:
            return worker.run(request, attempts)
        finally:
            free.put(worker)

    with ThreadPoolExecutor(max(1, len(workers))) as pool:
        numbers = {pool.submit(run, one): number for number, one in enumerate(requests)}
        try:
            for future in as_completed(numbers):
                # Popped: reports of up to 100,000 runs are not kept.
                yield numbers.pop(future), future.result()
        finally:
            for worker in workers:
                worker.stop()
            pool.shutdown(cancel_futures=True)
            for worker in workers:
                worker.close()


def main() -> None:
    """Run the scenarios of the requests on stdin."""
    die_with_parent()
    replies = reserve_stdout()
    _import_libraries()
    write_frame(replies, b"")
    copies = _Copies()
    while (frame := read_frame(STDIN)) is not None:
        outcome = copies.run(msgspec.msgpack.decode(frame, type=RunRequest))
        write_frame(replies, msgspec.msgpack.encode(outcome))
        if not CAN_COPY:
            return


class _Copies:
    """Copies of this process, in which scenarios run."""

    def __init__(self) -> None:
        self._shared: ServingCopy | None = None
        self._runs = 0

    def run(self, request: RunRequest) -> CopyOutcome:
        """Run a scenario, and again in another copy for its recording if it fails.

        Whatever the second run does, the verdict of the first stays.
        """
        began_s = time.monotonic()
        outcome, report = self._run_once(request)
        if report is None or not _needs_recording(request, report, time.monotonic() - began_s):
            return outcome
        _, repeated = _decode(run_in_copy(partial(_run_encoded, _make_recorded(request))))
        if repeated is None:
            return outcome
        return CopyOutcome(0, msgspec.msgpack.encode(_add_recording(report, repeated)))

    def _run_once(self, request: RunRequest) -> tuple[CopyOutcome, RunReport | None]:
        if not CAN_COPY or request.is_served or _has_code(request):
            return _decode(run_in_copy(partial(_run_encoded, request)))
        shared = self._get_shared()
        self._runs += 1
        found = shared.call(msgspec.msgpack.encode(request))
        if found.status:
            self._shared = None
        return _decode(found)

    def _get_shared(self) -> ServingCopy:
        if self._shared is not None and self._shared.is_alive and self._runs < MAX_RUNS_OF_COPY:
            return self._shared
        if self._shared is not None:
            self._shared.close()
        self._shared, self._runs = ServingCopy(_run_frame), 0
        return self._shared


def _has_code(request: RunRequest) -> bool:
    """Whether a run executes code of the author; one with mistakes does not begin."""
    try:
        return request.allows_python and read_scenario(request.file, request.settings).has_code
    except (ScenarioInvalid, OSError):
        return False


def _decode(outcome: ProcessOutcome) -> tuple[CopyOutcome, RunReport | None]:
    found = CopyOutcome(*outcome)
    if found.status or not found.report:
        return found, None
    return found, msgspec.msgpack.decode(found.report, type=RunReport)


def _run_frame(frame: bytes) -> bytes:
    return _run_encoded(msgspec.msgpack.decode(frame, type=RunRequest))


def _run_encoded(request: RunRequest) -> bytes:
    return msgspec.msgpack.encode(run_once(request))


def _import_libraries() -> None:
    """Import what a world in process needs, before the copies are made."""
    describe_host()
    # What is missing is reported by the run that needs it.
    with contextlib.suppress(ImportError):
        import_module("zensim.api.in_process_world")
        import_module("zensim.sim_server.physics.mujoco.mujoco_engine")


if __name__ == "__main__":
    main()
