"""Child processes of programs on this host, from /proc: their CPU time and memory."""

import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

import msgspec

PROC: Final = Path("/proc")
PARENT_FIELD, USER_FIELD, SYSTEM_FIELD, PAGES_FIELD = 1, 11, 12, 21
"""Fields of `stat`, counted from the state, which follows the name in brackets."""
MAX_NAME: Final = 40


class LocalProcess(msgspec.Struct, frozen=True):
    """A process on this host."""

    process_id: int
    parent_id: int
    name: str
    cpu_s: float
    memory_bytes: int


def list_descendants(roots: Iterable[int], proc: Path = PROC) -> list[LocalProcess]:
    """List the descendants of processes, without these; none where there is no /proc."""
    known = set(roots)
    processes = sorted(_read_all(proc), key=lambda one: one.process_id)
    found: dict[int, LocalProcess] = {}
    while True:
        parents = known | found.keys()
        more = [
            one for one in processes if one.parent_id in parents and one.process_id not in parents
        ]
        if not more:
            return sorted(found.values(), key=lambda one: one.process_id)
        found |= {one.process_id: one for one in more}


def _read_all(proc: Path) -> Iterator[LocalProcess]:
    if not proc.is_dir():
        return
    for folder in proc.iterdir():
        if folder.name.isdigit() and (found := _read_process(folder)) is not None:
            yield found


def _read_process(folder: Path) -> LocalProcess | None:
    """Read a process; None if it has ended."""
    try:
        name, _, rest = (folder / "stat").read_text(errors="replace").rpartition(")")
        words = (folder / "cmdline").read_bytes().decode(errors="replace").split("\0")
    except OSError:
        return None
    fields = rest.split()
    return LocalProcess(
        process_id=int(folder.name),
        parent_id=int(fields[PARENT_FIELD]),
        name=_name_command(words) or name.partition("(")[2],
        cpu_s=(int(fields[USER_FIELD]) + int(fields[SYSTEM_FIELD])) / os.sysconf("SC_CLK_TCK"),
        memory_bytes=int(fields[PAGES_FIELD]) * os.sysconf("SC_PAGE_SIZE"),
    )


def _name_command(words: list[str]) -> str:
    """Name a program of Python by its module and first word; empty for others."""
    if "-m" not in words:
        return ""
    return " ".join(word for word in words[words.index("-m") + 1 :][:2] if word)[:MAX_NAME]
