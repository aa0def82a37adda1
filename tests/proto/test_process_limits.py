"""Process limits: end with the parent, resource limits, niceness."""

import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from tests.contract.repository import ROOT
from zensim.proto.process_limits import limit_unacknowledged_time, set_niceness

LIMITED = """
import resource as r
from zensim.proto.process_limits import ResourceLimits, allow_cpu_time, set_resource_limits
set_resource_limits(ResourceLimits({memory}, total_cpu_s={cpu}, is_sandboxed={sandboxed}))
allow = allow_cpu_time
{then}
"""


def run_limited(
    then: str, *, memory: int = 1 << 28, cpu: int | None = None, sandboxed: bool = False
) -> "subprocess.CompletedProcess[str]":
    """Run statements under limits."""
    code = LIMITED.format(memory=memory, cpu=cpu, sandboxed=sandboxed, then=then)
    return subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def test_memory_is_limited_beyond_what_the_process_has() -> None:
    assert run_limited("x = bytearray(1 << 27)").returncode == 0
    assert "MemoryError" in run_limited("x = bytearray(1 << 29)").stderr


def test_cpu_time_is_limited() -> None:
    done = run_limited("while True: pass", cpu=1)

    assert done.returncode in (-signal.SIGKILL, -signal.SIGXCPU)


def test_cpu_time_is_allowed_again_for_each_request() -> None:
    done = run_limited("allow(5); print(r.getrlimit(r.RLIMIT_CPU)[0]); allow(9); allow(1)")

    assert (done.returncode, done.stdout) == (0, "6\n")


@pytest.mark.parametrize("limit", ["NOFILE", "FSIZE", "NPROC", "CORE"])
def test_sandboxed_process_gets_no_files_and_no_processes(limit: str) -> None:
    done = run_limited(f"print(r.getrlimit(r.RLIMIT_{limit}))", sandboxed=True)

    assert done.stdout == "(0, 0)\n"


def test_process_that_is_not_sandboxed_may_open_files() -> None:
    assert run_limited("open('/dev/null').close()").returncode == 0


NICENESS = 19
SET_NICENESS = f"""
import os
from zensim.proto.process_limits import set_niceness
print(set_niceness({NICENESS}))
print(os.getpriority(os.PRIO_PROCESS, 0), flush=True)
"""
HAS_SESSION_SHARES = Path("/proc/self/autogroup").exists()


def read_session_share(process_id: int) -> str:
    if not HAS_SESSION_SHARES:
        return ""
    return Path(f"/proc/{process_id}/autogroup").read_text(encoding="ascii").strip()


def test_session_leader_sets_the_niceness_of_its_session() -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", f"{SET_NICENESS}input()"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert process.stdout is not None
    is_done, niceness = process.stdout.readline(), process.stdout.readline()
    share = read_session_share(process.pid)
    process.communicate("\n")

    assert int(niceness) == NICENESS
    # The kernel may have been busy just then.
    assert not share or is_done == "False\n" or share.endswith(f"nice {NICENESS}")


def test_process_of_another_session_keeps_the_niceness_of_the_session() -> None:
    before = read_session_share(os.getpid())

    done = subprocess.run(
        [sys.executable, "-c", SET_NICENESS], capture_output=True, text=True, check=True
    )

    assert done.stdout.split() == ["True", str(NICENESS)]
    assert before == read_session_share(os.getpid())


def test_niceness_of_a_process_that_has_ended_is_no_error() -> None:
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()

    assert set_niceness(5, process.pid)


def test_limit_of_open_files_is_raised_as_far_as_allowed() -> None:
    text = (
        "import resource; from zensim.proto.process_limits import raise_file_limit;"
        "resource.setrlimit(resource.RLIMIT_NOFILE, (64, 512));"
        "print(raise_file_limit(), *resource.getrlimit(resource.RLIMIT_NOFILE))"
    )

    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=True)

    assert done.stdout.split() == ["512", "512", "512"]


def test_accepted_connections_are_reset_when_their_peer_takes_no_data() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        is_found = limit_unacknowledged_time(port, 1500)
        with socket.create_connection(("127.0.0.1", port)):
            accepted, _ = listener.accept()
            with accepted:
                limit_ms = accepted.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT)

    assert (is_found, limit_ms) == (True, 1500)
    assert not limit_unacknowledged_time(port, 1500)


def test_search_for_a_listener_leaves_no_open_files() -> None:
    before = psutil.Process().num_fds()

    with socket.create_server(("127.0.0.1", 0)) as listener:
        assert limit_unacknowledged_time(listener.getsockname()[1], 1500)

    assert psutil.Process().num_fds() == before
