"""Records of vehicles in an SQLite file, so that another process continues their orders."""

import sqlite3
from collections.abc import Mapping
from pathlib import Path

import msgspec

from zensim.vda5050.vehicle import VehicleRecord


class RecordStore:
    """Keeps the newest record of each vehicle; what is saved survives a killed process."""

    def __init__(self, path: Path | None) -> None:
        """Open the file, which is made if it is missing.

        Args:
            path: None = nothing outlives the process.

        Raises:
            OSError: It is no file of records, or another process uses it.
        """
        self._file = sqlite3.connect(path or ":memory:", timeout=1.0, isolation_level=None)
        try:
            self._file.execute("PRAGMA locking_mode = EXCLUSIVE")
            self._file.execute("PRAGMA journal_mode = WAL")
            self._file.execute("PRAGMA synchronous = NORMAL")
            self._file.execute("CREATE TABLE IF NOT EXISTS vehicles (name PRIMARY KEY, record)")
        except sqlite3.Error as error:
            self._file.close()
            raise OSError(f"`state` {path}: {error}; give a file of this program alone") from None

    def load(self, name: str) -> VehicleRecord | None:
        """Load the record of a vehicle; None if there is none that can be read."""
        found = self._file.execute("SELECT record FROM vehicles WHERE name = ?", (name,)).fetchone()
        try:
            return msgspec.json.decode(found[0], type=VehicleRecord) if found else None
        except msgspec.MsgspecError:
            return None

    def save(self, records: Mapping[str, VehicleRecord]) -> None:
        """Save records in one transaction."""
        if records:
            rows = [(name, msgspec.json.encode(one)) for name, one in records.items()]
            self._file.execute("BEGIN")
            self._file.executemany("INSERT OR REPLACE INTO vehicles VALUES (?, ?)", rows)
            self._file.execute("COMMIT")

    def close(self) -> None:
        """Close the file."""
        self._file.close()
