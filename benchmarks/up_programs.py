"""Processes of `zensim up`, by program."""

from typing import TYPE_CHECKING

import psutil

if TYPE_CHECKING:
    from subprocess import Popen

SERVER = "server"
PROGRAMS = {
    "agents": (".prepared_start agent",),
    "sensors": (".prepared_start sensors",),
    "router": (".prepared_start router",),
    "recorder": (" record --all ",),
    "page": (" view --connect ",),
}
"""What the command line of a program has, by group; others belong to the server."""


def find_programs(process: "Popen[str]") -> dict[str, tuple[int, ...]]:
    """Group the processes of `zensim up` by program; a program that does not run has none."""
    groups: dict[str, list[int]] = {SERVER: [], **{group: [] for group in PROGRAMS}}
    groups["zensim up"] = [process.pid]
    for child in psutil.Process(process.pid).children(recursive=True):
        groups[_find_group(" ".join(child.cmdline()))].append(child.pid)
    return {group: tuple(found) for group, found in groups.items()}


def _find_group(words: str) -> str:
    return next(
        (group for group, marks in PROGRAMS.items() if any(mark in words for mark in marks)), SERVER
    )
