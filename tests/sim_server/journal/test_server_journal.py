"""Probing: what ends a process is found by others, and this one goes on."""

import os
import signal
import time
from collections.abc import Callable

import pytest

from zensim.sim_server.journal import server_journal
from zensim.sim_server.journal.server_journal import find_crashing


def harmless() -> None:
    pass


def fatal() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def raising() -> None:
    raise RuntimeError("no harm")


@pytest.mark.parametrize(
    ("tries", "expected"),
    [
        ([], []),
        ([harmless, raising, harmless], []),
        ([fatal], [0]),
        ([harmless, fatal, harmless, raising, fatal], [1, 4]),
    ],
)
def test_probing_numbers_those_that_kill(
    tries: list[Callable[[], None]], expected: list[int]
) -> None:
    assert find_crashing(tries) == expected


def test_probing_leaves_out_nobody_who_kills_once(tmp_path: os.PathLike[str]) -> None:
    mark = os.path.join(tmp_path, "mark")  # noqa: PTH118

    def fatal_once() -> None:
        if not os.path.exists(mark):  # noqa: PTH110
            os.close(os.open(mark, os.O_CREAT))
            fatal()

    assert find_crashing([harmless, fatal_once]) == []


def test_probing_takes_what_never_ends_for_deadly(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server_journal, "DEADLINE_S", 0.1)

    assert find_crashing([harmless, lambda: time.sleep(30.0)]) == [1]


def test_probing_changes_nothing_here() -> None:
    seen: list[int] = []

    find_crashing([lambda: seen.append(1)])

    assert seen == []
