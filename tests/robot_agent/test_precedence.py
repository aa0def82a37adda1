"""When an agent stands back for physics, and what it may touch to do so."""

import os
import subprocess
import sys
from pathlib import Path

from zensim.proto.messages.agent_messages import DriveState
from zensim.robot_agent.precedence import NICENESS, Precedence

MS = 1_000_000
NICE = f"from robot_agent.precedence import be_nice; print(be_nice({NICENESS}))"
TOLD = "; import os; print(os.getpriority(os.PRIO_PROCESS, 0))"


def state(time_ns: int, *, is_awaited: bool = False) -> DriveState:
    return DriveState(0, 0, time_ns, b"", b"", b"", b"", is_awaited=is_awaited)


class Wishes:
    """What was asked of the kernel, which is too busy for the first few."""

    def __init__(self, refusals: int = 0) -> None:
        self.asked: list[int] = []
        self._refusals = refusals

    def __call__(self, niceness: int) -> bool:
        self.asked.append(niceness)
        return len(self.asked) > self._refusals


def run(
    precedence: Precedence, factor: float, *, from_s: float = 0.0, awaited: bool = False
) -> None:
    """Let two seconds pass, told every 10 ms of them."""
    for tick in range(200):
        now_s = from_s + tick * 0.01
        told = state(round(1000 * from_s * MS + tick * 10 * MS * factor), is_awaited=awaited)
        precedence.note_state(now_s, told)


def shares_of(process_id: int) -> str:
    return Path(f"/proc/{process_id}/autogroup").read_text(encoding="ascii").strip()


def test_agent_stands_back_once_when_time_runs_fast() -> None:
    wishes = Wishes()

    run(Precedence(wishes), factor=4.0)

    assert wishes.asked == [NICENESS]


def test_agent_stays_where_it_is_in_real_time() -> None:
    wishes = Wishes()

    run(Precedence(wishes), factor=1.0)

    assert wishes.asked == []


def test_agent_stays_where_it_is_when_time_waits_for_it() -> None:
    wishes = Wishes()

    run(Precedence(wishes), factor=4.0, awaited=True)

    assert wishes.asked == []


def test_agent_asks_again_when_the_kernel_is_busy() -> None:
    wishes = Wishes(refusals=2)

    run(Precedence(wishes), factor=4.0)

    assert wishes.asked == [NICENESS] * 3


def test_agent_comes_forward_when_time_runs_slowly_again() -> None:
    wishes = Wishes()
    precedence = Precedence(wishes)

    run(precedence, factor=4.0)
    run(precedence, factor=1.0, from_s=100.0)

    assert wishes.asked == [NICENESS, 0]


def test_agent_bears_a_reset_of_time() -> None:
    wishes = Wishes()
    precedence = Precedence(wishes)

    run(precedence, factor=1.0, from_s=100.0)
    precedence.note_state(103.0, state(0))
    precedence.note_state(103.6, state(600 * MS))

    assert wishes.asked == []


def test_process_of_a_session_of_its_own_takes_the_session_along() -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", f"{NICE}{TOLD}; input()"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert process.stdout is not None
    is_done, niceness = process.stdout.readline(), process.stdout.readline()
    shares = shares_of(process.pid) if Path("/proc/self/autogroup").exists() else ""
    process.communicate("\n")

    assert int(niceness) == NICENESS
    # The kernel may have had too many wishes just then, and says so.
    assert not shares or is_done == "False\n" or shares.endswith(f"nice {NICENESS}")


def test_process_of_the_users_session_leaves_the_session_alone() -> None:
    has_shares = Path("/proc/self/autogroup").exists()
    before = shares_of(os.getpid()) if has_shares else ""

    done = subprocess.run(
        [sys.executable, "-c", NICE + TOLD], capture_output=True, text=True, check=True
    )

    assert done.stdout.split() == ["True", str(NICENESS)]
    assert before == (shares_of(os.getpid()) if has_shares else "")
