"""Attempts that crash a process are found in forks."""

import os
import signal
import time
from collections.abc import Callable

import pytest

from zensim.sim_server.journal import server_journal
from zensim.sim_server.journal.server_journal import find_crashing


def harmless() -> None:
    pass


def crash() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def raising() -> None:
    raise RuntimeError("no harm")


@pytest.mark.parametrize(
    ("attempts", "expected"),
    [
        ([], []),
        ([harmless, raising, harmless], []),
        ([crash], [0]),
        ([harmless, crash, harmless, raising, crash], [1, 4]),
    ],
)
def test_attempts_that_crash_are_found(
    attempts: list[Callable[[], None]], expected: list[int]
) -> None:
    assert find_crashing(attempts) == expected


def test_attempt_that_crashes_once_is_not_reported(tmp_path: os.PathLike[str]) -> None:
    mark = os.path.join(tmp_path, "mark")  # noqa: PTH118

    def crash_once() -> None:
        if not os.path.exists(mark):  # noqa: PTH110
            os.close(os.open(mark, os.O_CREAT))
            crash()

    assert find_crashing([harmless, crash_once]) == []


def test_attempt_that_does_not_end_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server_journal, "DEADLINE_S", 0.1)

    assert find_crashing([harmless, lambda: time.sleep(30.0)]) == [1]


def test_attempts_have_no_effect_in_this_process() -> None:
    seen: list[int] = []

    find_crashing([lambda: seen.append(1)])

    assert seen == []
