"""Records of the `zensim up` that run on this host, in files that they keep locked."""

import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import msgspec

from zensim.proto.bounded_files import MAX_OWN_FILE_BYTES, read_file
from zensim.proto.process_limits import lock_file
from zensim.proto.runtime_folder import find_runtime_folder, is_own, make_runtime_folder

END_TIMEOUT_S = 20.0
POLL_S = 0.05


class LocalRun(msgspec.Struct, frozen=True):
    """One `zensim up`."""

    process_id: int
    endpoint: str
    world: str
    robots: int
    page: str = ""


@contextmanager
def recorded_run(run: LocalRun) -> Iterator[None]:
    """Keep the record of a run while the block runs; without a folder there is none."""
    descriptor, path = -1, find_runtime_folder() / f"{run.process_id}.json"
    with suppress(OSError):
        if make_runtime_folder() is not None:
            list_runs()  # which removes records of runs that were killed
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o600)
            lock_file(descriptor)
            os.write(descriptor, msgspec.json.encode(run))
    try:
        yield
    finally:
        if descriptor >= 0:
            os.close(descriptor)
            path.unlink(missing_ok=True)


def list_runs() -> list[LocalRun]:
    """List the runs that are alive, by process id; records of others are removed."""
    folder = find_runtime_folder()
    if not (folder.is_dir() and is_own(folder)):
        return []
    found = (_read_run(path) for path in folder.glob("[0-9]*.json"))
    return sorted((run for run in found if run is not None), key=lambda run: run.process_id)


def end_run(run: LocalRun, timeout_s: float = END_TIMEOUT_S) -> bool:
    """Terminate a run; return whether it ended in time."""
    with suppress(ProcessLookupError):
        os.kill(run.process_id, signal.SIGTERM)
    deadline_s = time.monotonic() + timeout_s
    while run in list_runs():
        if time.monotonic() > deadline_s:
            return False
        time.sleep(POLL_S)
    return True


def _read_run(path: Path) -> LocalRun | None:
    """Read a record whose process keeps it locked; remove it if none does."""
    try:
        descriptor = os.open(path, os.O_RDWR)
    except OSError:
        return None
    try:
        lock_file(descriptor)
    except OSError:
        with suppress(OSError, msgspec.DecodeError):
            return msgspec.json.decode(read_file(path, MAX_OWN_FILE_BYTES), type=LocalRun)
        return None
    finally:
        os.close(descriptor)
    path.unlink(missing_ok=True)
    return None
