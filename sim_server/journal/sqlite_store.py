"""SQLite store of the journal: rows and their digests, transactions, integrity checks."""

from __future__ import annotations

import hashlib
import logging
import os
import re
import shutil
import sqlite3
import struct
from contextlib import closing, contextmanager, suppress
from importlib.metadata import version
from typing import TYPE_CHECKING, Literal

from zensim.proto.bounded_files import open_regular_file
from zensim.proto.process_limits import lock_file, sync_folder

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

LOG = logging.getLogger(__name__)
DATABASE, LOCK, FILES, COPIES = "journal.db", "lock", "files", "copies"
LOG_SUFFIX = "-wal"
LOG_BYTES_KEPT = 1 << 20
"""Bytes of the write-ahead log beside the database that stay, and need not be allocated anew."""
OPEN_ROW = "open", ""
"""Kind and key of a row that exists while a server uses the journal, or after it was killed. Then
the newest changes are in the log, which is never empty."""
WRITER_ROW = "writer", ""
"""Kind and key of the row with the version of zensim whose server opened the journal last."""
FIRST_VERSION = "0.1.0"
"""Version of journals without `WRITER_ROW`."""
VERSION_NAME = re.compile(r"[0-9A-Za-z][0-9A-Za-z.+_-]{0,63}")
"""Version of zensim, which names a folder."""
MIGRATIONS = (
    """
    CREATE TABLE rows (
        id INTEGER PRIMARY KEY, kind TEXT NOT NULL, key TEXT NOT NULL, body BLOB NOT NULL,
        digest BLOB NOT NULL, UNIQUE (kind, key));
    CREATE TABLE total (
        id INTEGER PRIMARY KEY CHECK (id = 1), position INTEGER NOT NULL, digest BLOB NOT NULL);
    """,
)
"""Statements that migrate the tables from each version to the next."""
DIGEST_BYTES = 8
DIGEST_SUM_MASK = (1 << 64) - 1
POSITION_MARK = struct.Struct("<Q8s")
BUSY_TIMEOUT_S = 2.0


class JournalError(Exception):
    """A journal cannot be used; the message is one line."""


class SqliteStore:
    """Rows by kind and key in an SQLite database; for one thread at a time."""

    def __init__(self, folder: Path, connection: sqlite3.Connection, lock: int | None) -> None:
        self.folder = folder
        self.position = 0
        self.lost = 0
        """Changes that were durable once and are missing now."""
        self.is_log_missing = False
        """Whether it was copied, without its log, while a server used it."""
        self._lock = lock
        self._connection = connection
        self._digests: dict[tuple[str, str], int] = {}
        self._undo: list[tuple[tuple[str, str], int | None]] = []
        self._sum = 0

    def put(self, kind: str, key: str, body: bytes) -> None:
        """Insert or replace a row."""
        digest = _digest_row(kind, key, body)
        self._connection.execute(
            "INSERT INTO rows (kind, key, body, digest) VALUES (?, ?, ?, ?) "
            "ON CONFLICT (kind, key) DO UPDATE SET body = excluded.body, digest = excluded.digest",
            (kind, key, body, digest.to_bytes(DIGEST_BYTES, "little")),
        )
        self._set_digest((kind, key), digest)

    def remove(self, kind: str, key: str) -> None:
        """Delete a row, if it exists."""
        if (kind, key) in self._digests:
            self._connection.execute("DELETE FROM rows WHERE kind = ? AND key = ?", (kind, key))
            self._set_digest((kind, key), None)

    def __contains__(self, row_key: tuple[str, str]) -> bool:
        """Whether there is a row of this kind and key."""
        return row_key in self._digests

    def rows(self, kind: str) -> dict[str, bytes]:
        """Read all rows of a kind."""
        found = self._connection.execute("SELECT key, body FROM rows WHERE kind = ?", (kind,))
        return dict(found.fetchall())

    def body(self, kind: str, key: str) -> bytes | None:
        """Read one row."""
        found = self._connection.execute(
            "SELECT body FROM rows WHERE kind = ? AND key = ?", (kind, key)
        ).fetchone()
        return found[0] if found else None

    def begin(self) -> None:
        """Begin a transaction."""
        self._connection.execute("BEGIN IMMEDIATE")

    def commit(self, position: int) -> None:
        """Commit the transaction durably.

        Raises:
            sqlite3.Error: It failed; call `rollback`.
        """
        total = (position, _digest_total(self._sum, position))
        self._connection.execute("UPDATE total SET position = ?, digest = ? WHERE id = 1", total)
        self._connection.execute("COMMIT")
        self._undo.clear()
        self.position = position
        self._write_mark()

    def rollback(self) -> None:
        """Roll back the transaction."""
        if self._connection.in_transaction:
            self._connection.execute("ROLLBACK")
        for row_key, digest in reversed(self._undo):
            self._set_digest(row_key, digest)
        self._undo.clear()

    @property
    def loss(self) -> str:
        """What is known to be missing, as a sentence; empty if nothing is."""
        if self.is_log_missing:
            return (
                f"{self.folder} was copied without {DATABASE}{LOG_SUFFIX} while a server used it: "
                f"changes after change {self.position} are lost; copy it again with "
                f"`zensim journal backup`, or accept that with "
                f"`zensim journal verify {self.folder} --accept-loss`"
            )
        if self.lost:
            return (
                f"{self.folder} is truncated: its last {self.lost} changes are lost; "
                f"a server would continue from change {self.position}"
            )
        return ""

    def mark_open(self, writer: str) -> None:
        """Note in the database file that the log belongs to it, and the version of the server."""
        self.begin()
        self.put(*WRITER_ROW, writer.encode())
        self.put(*OPEN_ROW, b"")
        self.commit(self.position)
        self.checkpoint()

    def read_writer(self) -> str:
        """Read the version of zensim whose server opened the journal last.

        Raises:
            JournalError: The row is damaged.
        """
        body: object = self.body(*WRITER_ROW)
        if body is None:
            return FIRST_VERSION
        name = body.decode("ascii", "replace") if isinstance(body, bytes) else ""
        if not VERSION_NAME.fullmatch(name):
            raise JournalError(self._damaged("the version of its server is unreadable"))
        return name

    def keep_copy(self, name: str) -> Path:
        """Copy the journal as it is to its folder for copies, and return the copy.

        A copy of that name is replaced when the new one is complete. Files of meshes, which never
        change, are linked where the file system can.

        Raises:
            JournalError: The journal is damaged, or there is no room.
        """
        copies = self.folder / COPIES
        target, unfinished = copies / name, copies / f"{name}.unfinished"
        with raising_journal_errors(copies):
            shutil.rmtree(unfinished, ignore_errors=True)
            self.backup(unfinished)
            for source in (self.folder / FILES).iterdir():
                _link_or_copy(source, unfinished / FILES / source.name)
            sync_folder(unfinished / FILES)
            shutil.rmtree(target, ignore_errors=True)
            unfinished.rename(target)
            sync_folder(copies)
        return target

    @property
    def log_bytes(self) -> int:
        """Size of the log; the first commit after a checkpoint cuts it to `LOG_BYTES_KEPT`."""
        log = self.folder / f"{DATABASE}{LOG_SUFFIX}"
        return log.stat().st_size if log.exists() else 0

    def checkpoint(self) -> None:
        """Copy the log into the database file; the log stays."""
        self._connection.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchall()

    def backup(self, folder: Path) -> None:
        """Copy the database, without meshes, to an empty folder; it may be in use.

        Raises:
            JournalError: The folder is not empty, or cannot be written.
        """
        with raising_journal_errors(folder):
            (folder / FILES).mkdir(parents=True, exist_ok=True)
            if (folder / DATABASE).exists() or any((folder / FILES).iterdir()):
                raise JournalError(f"{folder} has a journal already; use an empty folder")
            connection = _connect(folder)
            try:
                self._connection.backup(connection)
                copy = SqliteStore(folder, connection, None)
                copy.check()
                copy._remove_open_row()
            finally:
                connection.close()
            sync_folder(folder)

    def _remove_open_row(self) -> None:
        self.begin()
        self.remove(*OPEN_ROW)
        self.commit(self.position)

    def close(self) -> None:
        """Merge the write-ahead log into the database file, and unlock the folder."""
        if self._lock is not None:
            self._mark_closed()
        try:
            self._connection.close()
        finally:
            if self._lock is not None:
                os.close(self._lock)

    def check(self) -> None:
        """Compare all rows with their digests.

        Raises:
            JournalError: The database is damaged.
        """
        found = self._connection.execute("PRAGMA integrity_check(1)").fetchone()
        if found[0] != "ok":
            raise JournalError(self._damaged(" ".join(str(found[0]).split())[:200]))
        self._digests, self._sum = {}, 0
        for kind, key, body, digest in self._connection.execute(
            "SELECT kind, key, body, digest FROM rows"
        ):
            value = _digest_row(str(kind), str(key), body if isinstance(body, bytes) else b"")
            if value.to_bytes(DIGEST_BYTES, "little") != digest:
                raise JournalError(self._damaged(f"row {kind}/{str(key)[:80]} has changed"))
            self._digests[kind, key] = value
            self._sum = (self._sum + value) & DIGEST_SUM_MASK
        self._check_total()

    def _check_total(self) -> None:
        total = self._connection.execute("SELECT position, digest FROM total").fetchone()
        is_complete = total is not None and isinstance(total[0], int)
        if not is_complete or total[1] != _digest_total(self._sum, total[0]):
            raise JournalError(self._damaged("rows are missing or were added"))
        self.position = total[0]
        self.lost = max(0, self._read_mark() - self.position)

    def _mark_closed(self) -> None:
        try:
            self._remove_open_row()
        except sqlite3.Error:
            # The disk is full or gone: the log stays, and so does the mark.
            with suppress(sqlite3.Error):
                self.rollback()

    def _damaged(self, what: str) -> str:
        return f"{self.folder / DATABASE} is damaged: {what}; restore a copy, or use another folder"

    def _set_digest(self, row_key: tuple[str, str], digest: int | None) -> None:
        before = self._digests.pop(row_key, None)
        self._undo.append((row_key, before))
        if digest is not None:
            self._digests[row_key] = digest
        self._sum = (self._sum + (digest or 0) - (before or 0)) & DIGEST_SUM_MASK

    def _write_mark(self) -> None:
        """Write the position beside the database, so that a truncated database is detected."""
        if self._lock is not None:
            body = self.position.to_bytes(8, "little")
            os.pwrite(self._lock, POSITION_MARK.pack(self.position, _hash_bytes(body)), 0)

    def _read_mark(self) -> int:
        if not self._has_mark():
            return 0
        with open_regular_file(self.folder / LOCK) as stream:
            data = stream.read(POSITION_MARK.size)
        if len(data) < POSITION_MARK.size:
            return 0
        position, digest = POSITION_MARK.unpack(data)
        return int(position) if digest == _hash_bytes(data[:8]) else 0

    def _has_mark(self) -> bool:
        return (self.folder / LOCK).is_file()


def open_store(
    folder: Path, writer: str | None = None, *, accepts_loss: bool = False
) -> SqliteStore:
    """Open or create the journal of a folder for one server.

    If a server of another version used it, a copy of it is kept before anything is changed.

    Args:
        folder: Made if it does not exist.
        writer: Version of the server; that of zensim by default.
        accepts_loss: Whether to continue a copy that was made without its log.

    Raises:
        JournalError: The folder cannot be used or is locked, or the journal is damaged, or
            a copy without its log.
    """
    with raising_journal_errors(folder):
        (folder / FILES).mkdir(parents=True, exist_ok=True)
        lock = _lock_folder(folder)
        try:
            return _open_locked(
                folder, lock, writer or version("zensim"), accepts_loss=accepts_loss
            )
        except BaseException:
            os.close(lock)
            raise


@contextmanager
def open_store_read_only(folder: Path) -> Iterator[SqliteStore]:
    """Open a journal for reading while a server may write it.

    Raises:
        JournalError: There is none, or it is damaged.
    """
    with raising_journal_errors(folder):
        if not (folder / DATABASE).is_file():
            raise JournalError(
                f"{folder} is not a journal; use a folder of `zensim serve --journal`"
            )
        has_log = _has_log(folder)
        # Read-only: the last connection that can write would merge the log of a killed server.
        connection = _connect(folder, mode="ro")
        try:
            connection.execute("BEGIN")
            database = SqliteStore(folder, connection, None)
            _check_version(folder, connection)
            database.check()
            database.is_log_missing = OPEN_ROW in database and not has_log
            yield database
        finally:
            connection.close()


def _open_locked(folder: Path, lock: int, writer: str, *, accepts_loss: bool) -> SqliteStore:
    has_log = _has_log(folder)
    connection = _connect(folder)
    database = SqliteStore(folder, connection, lock)
    try:
        tables = _check_version(folder, connection)
        if tables > 0:
            database.check()
            database.is_log_missing = OPEN_ROW in database and not has_log
            if not accepts_loss:
                _require_log(database)
            _keep_former(database, writer, is_migrated=tables < len(MIGRATIONS))
        if tables < len(MIGRATIONS):
            _migrate(folder, connection, database._read_mark())  # noqa: SLF001  same module
            database.check()
        database.mark_open(writer)
    except BaseException:
        connection.close()
        raise
    return database


def _require_log(database: SqliteStore) -> None:
    if database.is_log_missing:
        raise JournalError(database.loss)


def _keep_former(database: SqliteStore, writer: str, *, is_migrated: bool) -> None:
    """Keep a copy of a journal of another version, or one that is to be migrated."""
    former = database.read_writer()
    if former != writer or is_migrated:
        copy = database.keep_copy(former)
        LOG.warning("a server of zensim %s wrote this journal; a copy is kept in %s", former, copy)


def _link_or_copy(source: Path, target: Path) -> None:
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)


def _has_log(folder: Path) -> bool:
    """Whether there is a log; opening the database makes an empty one."""
    log = folder / f"{DATABASE}{LOG_SUFFIX}"
    return log.is_file() and log.stat().st_size > 0


def _connect(folder: Path, mode: Literal["rwc", "ro"] = "rwc") -> sqlite3.Connection:
    connection = sqlite3.connect(
        f"{(folder / DATABASE).absolute().as_uri()}?mode={mode}",
        timeout=BUSY_TIMEOUT_S,
        isolation_level=None,
        check_same_thread=False,
        uri=True,
    )
    if mode == "ro":
        return connection
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("PRAGMA synchronous = FULL")
    # The caller makes checkpoints: one in a commit delays a reply by two more syncs.
    connection.execute("PRAGMA wal_autocheckpoint = 0")
    connection.execute(f"PRAGMA journal_size_limit = {LOG_BYTES_KEPT}")
    return connection


def _check_version(folder: Path, connection: sqlite3.Connection) -> int:
    version = int(connection.execute("PRAGMA user_version").fetchone()[0])
    if not 0 <= version <= len(MIGRATIONS):
        raise JournalError(
            f"{folder / DATABASE} has version {version}, and this zensim knows up to "
            f"{len(MIGRATIONS)}; use the zensim that wrote it, or another folder"
        )
    return version


def _migrate(folder: Path, connection: sqlite3.Connection, mark: int) -> None:
    version = _check_version(folder, connection)
    if version == 0 and mark > 0:
        raise JournalError(
            f"{folder / DATABASE} is empty, but {mark} changes were written to it; "
            "restore a copy, or use another folder"
        )
    connection.execute("BEGIN IMMEDIATE")
    for script in MIGRATIONS[version:]:
        for statement in filter(str.strip, script.split(";")):
            connection.execute(statement)
    if version == 0:
        connection.execute("INSERT INTO total VALUES (1, 0, ?)", (_digest_total(0, 0),))
    connection.execute(f"PRAGMA user_version = {len(MIGRATIONS)}")
    connection.execute("COMMIT")
    # The tables must not be lost with the end of the log.
    connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    sync_folder(folder)


def _lock_folder(folder: Path) -> int:
    lock = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        lock_file(lock)
    except OSError as error:
        os.close(lock)
        raise JournalError(
            f"{folder} is used by another server; stop it, or use another folder"
        ) from error
    return lock


def count_unchecked_rows(folder: Path, kind: str) -> int:
    """Count the rows of a kind in milliseconds; 0 if the database does not exist or is damaged."""
    try:
        with closing(_connect(folder, "ro")) as connection:
            found = connection.execute("SELECT count(*) FROM rows WHERE kind = ?", (kind,))
            return int(found.fetchone()[0])
    except sqlite3.Error:
        return 0


@contextmanager
def raising_journal_errors(folder: Path) -> Iterator[None]:
    """Convert errors of files and of SQLite to JournalError."""
    try:
        yield
    except sqlite3.Error as error:
        raise JournalError(
            f"{folder / DATABASE} cannot be used: {error}; "
            "make room for it, restore a copy, or use another folder"
        ) from error
    except OSError as error:
        raise JournalError(
            f"journal {folder} cannot be used: {error.strerror}; use a folder that can be written"
        ) from error


def _digest_row(kind: str, key: str, body: bytes) -> int:
    head = f"{kind}/{key}".encode()
    return int.from_bytes(_hash_bytes(len(head).to_bytes(4, "little") + head + body), "little")


def _digest_total(rows: int, position: int) -> bytes:
    return _hash_bytes(rows.to_bytes(8, "little") + position.to_bytes(8, "little", signed=True))


def _hash_bytes(data: bytes) -> bytes:
    return hashlib.blake2b(data, digest_size=DIGEST_BYTES).digest()
