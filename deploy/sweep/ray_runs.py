"""Runs of a sweep as tasks of Ray, on this host or on a cluster."""

import io
import logging
import os
import signal
import socket
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, redirect_stdout, suppress
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

import msgspec

from zensim.deploy.scenario_process import RunRequest, ScenarioWorker, make_error_report
from zensim.deploy.sweep.ray_cluster import RayUnavailable, local_cluster, protect_local_cluster
from zensim.deploy.sweep.sweep_runner import ATTEMPTS, EndedRuns
from zensim.scenario.scenario_runner import RunReport

if TYPE_CHECKING:
    from ray import ObjectRef

ADDRESS_VARIABLE = "RAY_ADDRESS"
"""Ray sets it in the programs of its jobs."""
LOCAL, CLIENT_SCHEME = "local", "ray://"
CONNECT_TIMEOUT_S = 10.0
MAX_SUBMITTED = 1000
"""Tasks that wait at once; an autoscaler adds hosts for them."""


class MissingRayExtra(Exception):
    """The packages of the ray extra are not installed."""


def require_ray() -> None:
    """Check that Ray is installed, without importing it.

    Raises:
        MissingRayExtra: It is not.
    """
    if find_spec("ray") is None:
        raise MissingRayExtra("ray is not installed; use pip install 'zensim[ray]'")


def check_cluster(address: str) -> None:
    """Check that a program listens at the address of a cluster; Ray itself waits for minutes.

    Args:
        address: As of `run_on_ray`; without a port, Ray has to find the cluster.

    Raises:
        RayUnavailable: None does.
    """
    chosen = _choose_address(address)
    host, _, port = chosen.removeprefix(CLIENT_SCHEME).rpartition(":")
    if not port.isdecimal():
        return
    try:
        socket.create_connection((host.strip("[]"), int(port)), CONNECT_TIMEOUT_S).close()
    except (OSError, OverflowError) as error:
        raise RayUnavailable(
            f"no cluster of Ray at {chosen}: {error}; start it, or use --ray-address {LOCAL}"
        ) from error


def _choose_address(address: str) -> str:
    return address or os.environ.get(ADDRESS_VARIABLE, LOCAL)


def run_encoded(request: bytes, folder: str) -> bytes:
    """Run an encoded request in a worker of Ray, and return the encoded report.

    Args:
        request: A `RunRequest`.
        folder: From which paths of files are relative.
    """
    with suppress(OSError):  # a host may lack it; absolute paths need none
        os.chdir(folder)
    found = _get_worker().run(msgspec.msgpack.decode(request, type=RunRequest), ATTEMPTS)
    return msgspec.msgpack.encode(found)


@cache
def _get_worker() -> ScenarioWorker:
    """Get the process that this worker of Ray keeps, and that has imported everything."""
    return ScenarioWorker()


def run_on_ray(requests: Sequence[RunRequest], *, jobs: int | None, address: str = "") -> EndedRuns:
    """Run scenarios as tasks of Ray; a task whose worker or node dies runs again.

    Args:
        requests: Scenarios whose files have these paths on all hosts.
        jobs: Number at once; None = all CPUs.
        address: Of a cluster, or `local`; empty = that of the variable RAY_ADDRESS, else `local`.

    Raises:
        RayUnavailable: No cluster could be started, or reached.
    """
    chosen = _choose_address(address)
    if chosen == LOCAL:
        protect_local_cluster()
    import ray  # noqa: PLC0415  180 MB, in an extra

    # The number of CPUs limits a cluster of this process.
    most = MAX_SUBMITTED if chosen == LOCAL or jobs is None else jobs
    began_s = time.time()
    with _connection(chosen, jobs):
        perform = ray.remote(num_cpus=1, max_retries=ATTEMPTS - 1)(run_encoded)
        left = deque(enumerate(requests))
        pending: dict[ObjectRef[bytes], int] = {}
        while left or pending:
            while left and len(pending) < most:
                number, request = left.popleft()
                encoded = msgspec.msgpack.encode(request)
                pending[perform.remote(encoded, str(Path.cwd()))] = number
            ready, _ = ray.wait(list(pending), num_returns=1)
            for reference in ready:
                number = pending.pop(reference)
                yield number, _read_report(reference, requests[number], began_s)


def _read_report(reference: "ObjectRef[bytes]", request: RunRequest, began_s: float) -> RunReport:
    import ray  # noqa: PLC0415
    from ray.exceptions import RayError  # noqa: PLC0415

    try:
        return msgspec.msgpack.decode(ray.get(reference), type=RunReport)
    except RayError as error:
        reason = " ".join(str(error).split())
        return make_error_report(request, f"{type(error).__name__}: {reason}", began_s)


@contextmanager
def _connection(address: str, jobs: int | None) -> Iterator[None]:
    """Connect to a cluster, or to one that is started for the block.

    Raises:
        RayUnavailable: There is none.
    """
    import ray  # noqa: PLC0415
    from ray.exceptions import RayError  # noqa: PLC0415

    with ExitStack() as stack:
        if address == LOCAL:
            address = stack.enter_context(local_cluster(jobs or os.cpu_count() or 1))
        stack.enter_context(redirect_stdout(StdoutOfThread()))
        stack.callback(_shut_down)
        try:
            with _kept_signals():
                ray.init(address, log_to_driver=False, logging_level=logging.ERROR)
        except (OSError, RuntimeError, ValueError, ImportError, RayError) as error:
            raise RayUnavailable(f"Ray at {address} cannot be used: {error}") from error
        yield


def _shut_down() -> None:
    import ray  # noqa: PLC0415

    with redirect_stdout(sys.stderr):  # messages that were held back
        ray.shutdown()


class StdoutOfThread(io.TextIOBase):
    """Standard output for the thread that makes it; what other threads print goes to stderr.

    A thread of Ray prints the deaths of workers to standard output, where rows are printed as JSON.
    """

    def __init__(self) -> None:
        """Begin with the standard output of now."""
        self._owner, self._stdout = threading.get_ident(), sys.stdout

    def write(self, text: str) -> int:
        """Write a text."""
        return self._find().write(text)

    def flush(self) -> None:
        """Write what is buffered."""
        self._find().flush()

    def fileno(self) -> int:
        """Find the descriptor of standard output."""
        return self._stdout.fileno()

    def _find(self) -> TextIO:
        return self._stdout if threading.get_ident() == self._owner else sys.stderr


@contextmanager
def _kept_signals() -> Iterator[None]:
    """Keep the handler of SIGTERM, which Ray replaces."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
