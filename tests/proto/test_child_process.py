"""Child processes: one-shot runs, frames, forks, ends."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator

import psutil
import pytest

from tests.integration.processes import eventually
from zensim.proto.child_process import (
    CHUNK_BYTES,
    FramedProcess,
    ProcessOutcome,
    encode_frame,
    end_processes,
    make_module_command,
    run_in_fork,
    run_process,
    start_process,
)

ENDS_S = 20.0
UPPERCASE = "import sys; sys.stdout.write(sys.stdin.read().upper())"
SLEEP = "import time; time.sleep(600)"
ECHO = """
from zensim.proto.child_process import STDIN, read_frame, reserve_stdout, write_frame
replies = reserve_stdout()
print("not a frame")
while (frame := read_frame(STDIN)) is not None:
    write_frame(replies, frame[::-1])
"""


def run_code(code: str) -> tuple[str, ...]:
    return (sys.executable, "-c", code)


@pytest.fixture
def echo() -> Iterator[FramedProcess]:
    process = FramedProcess(run_code(ECHO))
    yield process
    process.kill()
    process.wait()


def receive_one(process: FramedProcess) -> bytes:
    received: list[bytes] = []

    def is_received() -> bool:
        process.flush()
        received.extend(process.receive())
        return bool(received)

    eventually(is_received, ENDS_S, "a frame")
    (frame,) = received
    return frame


def test_module_runs_with_this_interpreter() -> None:
    outcome = run_process(make_module_command("json.tool", "--compact"), b"[1, 2]")

    assert (outcome.status, outcome.output.strip()) == (0, b"[1,2]")


def test_process_replies_to_its_request() -> None:
    outcome = run_process(run_code(UPPERCASE), b"abc")

    assert (outcome.status, outcome.output, outcome.is_out_of_time) == (0, b"ABC", False)


def test_process_that_fails_gives_its_status() -> None:
    assert run_process(run_code("raise SystemExit(9)"), b"").status == 9


def test_process_is_killed_at_its_deadline() -> None:
    before_s = time.monotonic()
    outcome = run_process(run_code(SLEEP), b"", timeout_s=0.2)

    assert outcome.is_out_of_time
    assert time.monotonic() - before_s < ENDS_S


def test_process_is_killed_when_its_caller_is_interrupted() -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    before = set(psutil.Process().children())
    former = signal.signal(signal.SIGALRM, interrupt)
    signal.setitimer(signal.ITIMER_REAL, 0.5)
    try:
        with pytest.raises(KeyboardInterrupt):
            run_process(run_code(SLEEP), b"")
    finally:
        signal.signal(signal.SIGALRM, former)

    assert set(psutil.Process().children()) <= before


def test_process_leads_its_own_session_and_gets_the_environment() -> None:
    code = "import os; print(os.getsid(0) == os.getpid(), os.environ['WORD'], 'PATH' in os.environ)"
    process = start_process(run_code(code), stdout=subprocess.PIPE, environment={"WORD": "here"})
    output, _ = process.communicate()

    assert output.split() == [b"True", b"here", b"True"]


def test_processes_that_ignore_sigterm_are_killed() -> None:
    stubborn = f"import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN); print(); {SLEEP}"
    processes = [
        start_process(run_code(code), stdout=subprocess.PIPE)
        for code in (f"print(); {SLEEP}", stubborn)
    ]
    for process in processes:
        assert process.stdout is not None
        process.stdout.readline()

    end_processes(dict.fromkeys(processes, 0.5))

    assert [process.returncode for process in processes] == [-signal.SIGTERM, -signal.SIGKILL]


def test_process_with_more_time_ends_by_itself_when_others_are_killed() -> None:
    slow = f"import signal; signal.signal(signal.SIGTERM, lambda *_: exit(3)); print(); {SLEEP}"
    stubborn = f"import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN); print(); {SLEEP}"
    patient, hasty = (
        start_process(run_code(code), stdout=subprocess.PIPE) for code in (slow, stubborn)
    )
    for process in (patient, hasty):
        assert process.stdout is not None
        process.stdout.readline()

    end_processes({hasty: 0.0, patient: 30.0})

    assert (patient.returncode, hasty.returncode) == (3, -signal.SIGKILL)


def test_process_that_is_not_finished_at_half_its_time_gets_a_second_signal() -> None:
    drains = """
import signal, time
signals = []
signal.signal(signal.SIGTERM, lambda *_: signals.append(1))
print()
while len(signals) < 2:
    time.sleep(0.01)
raise SystemExit(4)
"""
    process = start_process(run_code(drains), stdout=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.readline()

    end_processes({process: 2.0})

    assert process.returncode == 4


def test_frames_are_answered_in_order(echo: FramedProcess) -> None:
    for payload in (b"abc", b"", b"xy"):
        echo.send([encode_frame(payload)])
        assert receive_one(echo) == payload[::-1]


def test_frame_larger_than_the_pipe_is_exchanged(echo: FramedProcess) -> None:
    payload = os.urandom(3 * CHUNK_BYTES)
    frame = encode_frame(payload)
    echo.send(frame[start : start + 70_000] for start in range(0, len(frame), 70_000))

    assert receive_one(echo) == payload[::-1]


def test_chunks_are_requested_when_the_pipe_has_room() -> None:
    requested = []

    def chunks() -> Iterator[bytes]:
        for number in range(100):
            requested.append(number)
            yield bytes(1 << 16)

    process = FramedProcess(run_code(SLEEP))
    process.send(chunks())
    process.flush()

    assert 0 < len(requested) < 50
    process.kill()
    process.wait()


def test_framed_process_gives_its_exit_status() -> None:
    process = FramedProcess(run_code("raise SystemExit(3)"))
    eventually(lambda: process.poll() is not None, ENDS_S, "its end")

    process.send([encode_frame(b"late")])
    process.flush()

    assert (process.poll(), process.receive()) == (3, [])
    process.kill()


def test_framed_process_is_gone_when_killed() -> None:
    process = FramedProcess(run_code(SLEEP))
    process.kill()
    process.wait()

    assert process.poll() == -signal.SIGKILL
    assert not psutil.pid_exists(process.process_id)


def kill_itself(report: Callable[[int], None]) -> None:
    report(1)
    report(2)
    os.kill(os.getpid(), signal.SIGKILL)


def sleep_long(report: Callable[[int], None]) -> None:
    report(4)
    time.sleep(600.0)


def test_fork_gives_the_last_report_before_a_crash() -> None:
    last, status = run_in_fork(kill_itself, ENDS_S)

    assert last == 2
    assert status != 0


def test_fork_that_reports_nothing_for_long_is_killed() -> None:
    last, status = run_in_fork(sleep_long, 0.2)

    assert (last, os.WTERMSIG(status)) == (4, signal.SIGKILL)


def test_fork_changes_nothing_here() -> None:
    seen: list[int] = []

    assert run_in_fork(lambda _: seen.append(1), ENDS_S) == (None, 0)
    assert seen == []


COPY_CODE = """
import os, signal, sys
from zensim.proto.child_process import ServingCopy
seen = []
def reply(request):
    seen.append(request)
    if request == b"die":
        os.kill(os.getpid(), signal.SIGKILL)
    if request == b"exit":
        raise SystemExit
    return b" ".join(seen)
copy = ServingCopy(reply)
print(copy.call(b"a"), copy.call(b"b"), seen)
print(copy.call(sys.argv[1].encode()))
"""


@pytest.mark.parametrize(
    ("last", "status", "output"), [("c", 0, b"a b c"), ("die", -9, b""), ("exit", 1, b"")]
)
def test_serving_copy_replies_until_it_ends(last: str, status: int, output: bytes) -> None:
    done = run_process((*run_code(COPY_CODE), last), b"", timeout_s=ENDS_S)

    first, second = done.output.decode().splitlines()
    assert first == f"{ProcessOutcome(0, b'a')} {ProcessOutcome(0, b'a b')} []"
    assert second == str(ProcessOutcome(status, output))
