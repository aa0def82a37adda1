"""Entities that would kill a server are found by a process that may die in its stead."""

from __future__ import annotations

import os
import select
import signal
import struct
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

DEADLINE_S = 10.0
"""For one try."""
DEATHS = 2
"""How often an entity may end a process before it is set aside; the first time was the server."""
COUNT = struct.Struct("<I")


def deadly(tries: Sequence[Callable[[], None]]) -> list[int]:
    """Make tries one after another, each after those before it; number those that kill a process.

    Each is made in a copy of this process, so that nothing here has changed afterwards. One that
    raises is harmless. One that ends its process is made again in the next, alone of those that
    did; what kills twice is left out from then on.
    """
    deaths: dict[int, int] = {}
    while (number := _first_death(tries, [i for i in deaths if deaths[i] >= DEATHS])) is not None:
        deaths[number] = deaths.get(number, 0) + 1
    return [number for number, count in deaths.items() if count >= DEATHS]


def _first_death(tries: Sequence[Callable[[], None]], left_out: Sequence[int]) -> int | None:
    wanted = [number for number in range(len(tries)) if number not in left_out]
    if not wanted:
        return None
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reader)
        _make(tries, wanted, writer)
    os.close(writer)
    try:
        return _watch(reader, child, wanted)
    finally:
        os.close(reader)


def _make(tries: Sequence[Callable[[], None]], wanted: Sequence[int], writer: int) -> None:
    status = 1
    try:
        for number in wanted:
            os.write(writer, COUNT.pack(number))
            _try(tries[number])
        status = 0
    finally:
        os._exit(status)


def _try(make: Callable[[], None]) -> None:
    try:
        make()
    except Exception:  # noqa: BLE001  whoever restores it is told
        return


def _watch(reader: int, child: int, wanted: Sequence[int]) -> int | None:
    last = wanted[0]
    while True:
        if not select.select([reader], [], [], DEADLINE_S)[0]:
            os.kill(child, signal.SIGKILL)
        if not (data := os.read(reader, COUNT.size)):
            break
        last = COUNT.unpack(data)[0]
    _, status = os.waitpid(child, 0)
    return last if status else None
