"""A Ray cluster of this process, on this host: started, protected by a token, and ended with it."""

import os
import secrets
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

from zensim.proto.bounded_files import MAX_OWN_FILE_BYTES, read_file, read_text_file
from zensim.proto.child_process import end_processes, make_module_command, start_process
from zensim.proto.endpoints import reserve_port
from zensim.proto.parent_death import die_with_parent

AUTHENTICATION_VARIABLE, TOKEN_VARIABLE = "RAY_AUTH_MODE", "RAY_AUTH_TOKEN"
USAGE_VARIABLE = "RAY_USAGE_STATS_ENABLED"
PATIENCE = {
    "RAY_agent_register_timeout_ms": "120000",
    "RAY_gcs_server_request_timeout_seconds": "120",
    "RAY_raylet_start_wait_time_s": "120",
}
"""How long parts of Ray wait for each other, on a host that is busy."""
PORTS = (
    "--port",
    "--dashboard-agent-grpc-port",
    "--dashboard-agent-listen-port",
    "--metrics-export-port",
    "--runtime-env-agent-port",
)
"""Ports that are set: without them, agents have 15 s to start and to write their ports to files;
no option changes that (https://github.com/ray-project/ray/issues/65983)."""
CLIENT_PORT = "--ray-client-server-port"
START_TIMEOUT_S, START_POLL_S, END_TIMEOUT_S = 180.0, 0.05, 20.0
STORE_BYTES = 80 << 20
"""Size of shared memory: reports have some kilobytes."""
SHORT_FOLDER = Path("/tmp")
"""Paths of sockets have at most 107 bytes."""
PREFIX = "zensim-ray-"
ADDRESS_FILE = "ray_current_cluster"
"""`ray start` writes it to its folder when the cluster is ready."""


class RayUnavailable(ConnectionError):
    """No cluster of Ray could be started, or reached."""


def protect_local_cluster() -> None:
    """Let a cluster that this process starts refuse whatever does not have its token.

    Ray listens on all addresses, and a program that reaches it can run code. This has to be called
    before Ray is imported; a mode that the user has chosen stays.
    """
    os.environ.setdefault(USAGE_VARIABLE, "0")
    if AUTHENTICATION_VARIABLE not in os.environ:
        os.environ[AUTHENTICATION_VARIABLE] = "token"
        os.environ[TOKEN_VARIABLE] = secrets.token_hex(32)


@contextmanager
def local_cluster(cpus: int) -> Iterator[str]:
    """Run a cluster for the block, and return its address.

    Args:
        cpus: Number of tasks at once.

    Raises:
        RayUnavailable: It did not start.
    """
    parent = SHORT_FOLDER if SHORT_FOLDER.is_dir() else None
    # Its files and sockets are for this user only.
    with tempfile.TemporaryDirectory(prefix=PREFIX, dir=parent, ignore_cleanup_errors=True) as name:
        folder = Path(name)
        with (folder / "start.log").open("wb") as log:
            head = start_process(
                make_module_command(__name__, str(os.getpid()), *_list_options(folder, cpus)),
                stdout=log.fileno(),
                stderr=subprocess.STDOUT,
                environment={**PATIENCE, **os.environ},
            )
        try:
            yield _await_address(head, folder)
        finally:
            end_processes({head: END_TIMEOUT_S})


def _list_options(folder: Path, cpus: int) -> list[str]:
    # Its server listens at port 10001 otherwise, wherever gRPC is installed.
    ports = (*PORTS, CLIENT_PORT) if find_spec("grpc") else PORTS
    return [
        *("--head", "--block", "--disable-usage-stats", "--no-monitor"),
        *("--include-dashboard=false", "--include-log-monitor=false"),
        *(f"--num-cpus={cpus}", f"--object-store-memory={STORE_BYTES}", f"--temp-dir={folder}"),
        *(f"{option}={reserve_port('0.0.0.0')}" for option in ports),
    ]


def _await_address(head: "subprocess.Popen[bytes]", folder: Path) -> str:
    deadline_s = time.monotonic() + START_TIMEOUT_S
    while not (address := _read_address(folder)):
        if head.poll() is not None or time.monotonic() > deadline_s:
            raise RayUnavailable(f"Ray did not start: {_find_reason(folder, head.returncode)}")
        time.sleep(START_POLL_S)
    return address


def _read_address(folder: Path) -> str:
    try:
        return read_text_file(folder / ADDRESS_FILE).strip()
    except FileNotFoundError:
        return ""


def _find_reason(folder: Path, status: int | None) -> str:
    """Find the last line that `ray start` has printed before it ended."""
    if status is None:
        return f"it was not ready after {START_TIMEOUT_S:g} s; use --on processes on a busy host"
    lines = read_file(folder / "start.log", MAX_OWN_FILE_BYTES).decode(errors="replace").split("\n")
    return next((line for line in reversed(lines) if line.strip()), f"status {status}")


def run_head(parent: int, options: list[str]) -> None:
    """Become `ray start`, which keeps what the kernel shall do at the end of the parent."""
    die_with_parent(signal.SIGTERM, parent=parent)
    command = make_module_command("ray.scripts.scripts", "start", *options)
    os.execv(command[0], command)


if __name__ == "__main__":
    run_head(int(sys.argv[1]), sys.argv[2:])
