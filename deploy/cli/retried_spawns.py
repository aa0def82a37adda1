"""Ids of spawns that got no reply in time, kept for the next command: it may be their retry."""

import hashlib
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

import msgspec

from zensim.proto.bounded_files import MAX_OWN_FILE_BYTES, read_file
from zensim.proto.bus.bus_session import Bus
from zensim.proto.runtime_folder import make_runtime_folder
from zensim.proto.whole_files import writing_whole

KEPT_S: Final = 120.0
"""Wall time in which the same command is taken for a retry, and not for another robot."""


class UnansweredSpawn(msgspec.Struct, frozen=True):
    """A spawn whose command has given up."""

    key: str
    digest: bytes
    request_id: str
    until_s: float
    """Wall time since the epoch."""


@contextmanager
def keeping_unanswered_spawns(bus: Bus) -> Iterator[None]:
    """Take the ids of earlier commands at this endpoint; keep those without a reply at the end.

    Without a folder of this user nothing is kept.
    """
    folder = make_runtime_folder()
    if folder is None:
        yield
        return
    endpoint = hashlib.sha256(bus.endpoint.encode()).hexdigest()[:16]
    file = folder / f"spawns-{endpoint}.msgpack"
    before = _read(file)
    bus.unanswered.update(((one.key, one.digest), one.request_id) for one in before)
    try:
        yield
    finally:
        until_s = {one.request_id: one.until_s for one in before}
        with suppress(OSError):
            _write(
                file,
                [
                    UnansweredSpawn(*of, name, until_s.get(name, time.time() + KEPT_S))
                    for of, name in bus.unanswered.items()
                ],
            )


def _read(file: Path) -> list[UnansweredSpawn]:
    try:
        found = msgspec.msgpack.decode(
            read_file(file, MAX_OWN_FILE_BYTES), type=list[UnansweredSpawn]
        )
    except (OSError, msgspec.MsgspecError):
        return []
    return [one for one in found if one.until_s > time.time()]


def _write(file: Path, spawns: list[UnansweredSpawn]) -> None:
    if not spawns:
        file.unlink(missing_ok=True)
        return
    with writing_whole(file, mode=0o600) as stream:
        stream.write(msgspec.msgpack.encode(spawns))
