"""File of the audit of a secured server: one JSON object a line, of a bounded size."""

import logging
import os
import threading
import time
from pathlib import Path
from queue import SimpleQueue
from typing import Final

import msgspec

from zensim.proto.messages.telemetry_messages import AuditRecord
from zensim.proto.rosout import FOR_OPERATORS

LOG = logging.getLogger(__name__)
NAME: Final = "audit.jsonl"
MAX_BYTES: Final = 8 << 20
"""Size beyond which the file becomes `audit.jsonl.1`, in place of the former one."""
MAX_BATCH: Final = 1000
CLOSE_TIMEOUT_S: Final = 2.0


class AuditFile:
    """Appends records in a thread of its own: a slow disk does not delay the caller."""

    def __init__(self, folder: Path, max_bytes: int = MAX_BYTES) -> None:
        self._path = folder / NAME
        self._max_bytes = max_bytes
        self._queue: SimpleQueue[AuditRecord | None] = SimpleQueue()
        self._is_failing = False
        self._thread = threading.Thread(target=self._run, name="audit file", daemon=True)
        self._thread.start()

    def keep(self, record: AuditRecord) -> None:
        """Append a record soon."""
        self._queue.put(record)

    def close(self) -> None:
        """Write what was given, and end; a disk that does not reply is left."""
        self._queue.put(None)
        self._thread.join(CLOSE_TIMEOUT_S)

    def _run(self) -> None:
        while (record := self._queue.get()) is not None:
            batch = [record]
            while len(batch) < MAX_BATCH and not self._queue.empty():
                if (record := self._queue.get()) is None:
                    self._append(batch)
                    return
                batch.append(record)
            self._append(batch)

    def _append(self, records: list[AuditRecord]) -> None:
        data = b"".join(write_audit_line(record) for record in records)
        try:
            self._rotate(len(data))
            descriptor = os.open(self._path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600)
            with os.fdopen(descriptor, "ab") as stream:
                stream.write(data)
        except OSError as error:
            if not self._is_failing:
                LOG.warning(
                    "audit not kept file=%s reason=%s", self._path, error, extra=FOR_OPERATORS
                )
            self._is_failing = True
        else:
            self._is_failing = False

    def _rotate(self, more: int) -> None:
        if self._path.is_file() and self._path.stat().st_size + more > self._max_bytes:
            self._path.replace(self._path.with_name(f"{NAME}.1"))


def write_audit_line(record: AuditRecord) -> bytes:
    """Write a record as a line of JSON, with its time in UTC."""
    seconds, rest = divmod(record.time_ns, 1_000_000_000)
    at = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(seconds))
    facts = {"time": f"{at}.{rest // 1_000_000:03}Z", **msgspec.structs.asdict(record)}
    del facts["time_ns"]
    return msgspec.json.encode(facts) + b"\n"
