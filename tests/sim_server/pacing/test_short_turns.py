"""Short turns: asked of the kernel that runs these tests, in threads that end with them."""

import os
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from zensim.sim_server.pacing.short_turns import TURN_NS, ask_for_short_turns, turn_ns

T = TypeVar("T")
ORDINARY_NS = turn_ns()
"""0 where the kernel does not tell."""
SHORT_NS = min(TURN_NS, ORDINARY_NS)
TELL = "from zensim.sim_server.pacing.short_turns import turn_ns; print(turn_ns())"


def aside(call: Callable[[], T]) -> T:
    """Call in a thread of its own."""
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(call).result()


def test_turns_are_short_when_asked_for() -> None:
    def asked() -> tuple[bool, int]:
        return ask_for_short_turns(), turn_ns()

    found = aside(asked)

    assert found == (True, SHORT_NS)


def test_niceness_stays_when_turns_become_short() -> None:
    def asked() -> tuple[int, int]:
        os.setpriority(os.PRIO_PROCESS, 0, os.getpriority(os.PRIO_PROCESS, 0) + 1)
        before = os.getpriority(os.PRIO_PROCESS, 0)
        ask_for_short_turns()
        return before, os.getpriority(os.PRIO_PROCESS, 0)

    before, after = aside(asked)

    assert after == before


def test_what_is_started_has_ordinary_turns() -> None:
    def started() -> int:
        ask_for_short_turns()
        command = [sys.executable, "-c", TELL]
        return int(subprocess.run(command, capture_output=True, check=True).stdout)

    found = aside(started)

    assert found == ORDINARY_NS


def test_thread_with_a_policy_of_its_own_keeps_it() -> None:
    def asked() -> tuple[bool, int]:
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
        return ask_for_short_turns(), os.sched_getscheduler(0)

    found = aside(asked)

    assert found == (False, os.SCHED_BATCH)
