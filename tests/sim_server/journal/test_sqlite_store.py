"""Ledger: what was committed is there, and whatever was damaged since is found."""

import random
import sqlite3
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from zensim.sim_server.journal import sqlite_store as ledger_module
from zensim.sim_server.journal.sqlite_store import (
    DATABASE,
    FILES,
    LOCK,
    MIGRATIONS,
    JournalError,
    SqliteStore,
    open_store,
    open_store_read_only,
)

CUTS = 60
FLIPS = 120
ROWS = {("entity", f"r{i}"): f"row {i}".encode() * 20 for i in range(40)}


def fill(ledger: SqliteStore, rows: dict[tuple[str, str], bytes], position: int) -> None:
    ledger.begin()
    for (kind, key), body in rows.items():
        ledger.put(kind, key, body)
    ledger.commit(position)


def killed(folder: Path, *batches: dict[tuple[str, str], bytes]) -> dict[str, bytes]:
    """Take the files of a journal as a kill leaves them: the newest changes beside the file."""
    ledger = open_store(folder)
    for position, rows in enumerate(batches, start=1):
        fill(ledger, rows, position)
    files = {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}
    ledger.close()
    return files


def put_there(folder: Path, files: dict[str, bytes]) -> Path:
    (folder / FILES).mkdir(parents=True)
    for name, data in files.items():
        if not name.endswith("-shm"):
            (folder / name).write_bytes(data)
    return folder


def state_of(folder: Path) -> tuple[int, int, dict[str, bytes]]:
    ledger = open_store(folder)
    try:
        return ledger.position, ledger.lost, ledger.rows("entity")
    finally:
        ledger.close()


def read(folder: Path) -> None:
    with open_store_read_only(folder):
        pass


def test_ledger_holds_what_was_committed_when_opened_again(tmp_path: Path) -> None:
    ledger = open_store(tmp_path / "j")
    fill(ledger, {("entity", "a"): b"1", ("entity", "b"): b"2"}, 7)
    ledger.begin()
    ledger.remove("entity", "a")
    ledger.put("entity", "b", b"3")
    ledger.commit(8)
    ledger.close()

    assert state_of(tmp_path / "j") == (8, 0, {"b": b"3"})


def test_ledger_holds_nothing_of_what_was_rolled_back(tmp_path: Path) -> None:
    ledger = open_store(tmp_path)
    fill(ledger, {("entity", "a"): b"1"}, 1)
    ledger.begin()
    ledger.put("entity", "a", b"2")
    ledger.put("entity", "b", b"3")
    ledger.remove("entity", "a")
    ledger.rollback()
    fill(ledger, {("entity", "c"): b"4"}, 2)
    ledger.close()

    assert state_of(tmp_path) == (2, 0, {"a": b"1", "c": b"4"})


def test_ledger_is_refused_to_a_second_server(tmp_path: Path) -> None:
    first = open_store(tmp_path)

    with pytest.raises(JournalError, match="used by another server"):
        open_store(tmp_path)

    first.close()
    open_store(tmp_path).close()


def test_ledger_can_be_read_while_a_server_writes(tmp_path: Path) -> None:
    ledger = open_store(tmp_path)
    fill(ledger, {("entity", "a"): b"1"}, 1)

    with open_store_read_only(tmp_path) as reader:
        fill(ledger, {("entity", "b"): b"2"}, 2)

        assert reader.rows("entity") == {"a": b"1"}
    ledger.close()


def test_ledger_of_a_newer_version_is_refused_in_one_line(tmp_path: Path) -> None:
    open_store(tmp_path).close()
    connection = sqlite3.connect(tmp_path / DATABASE)
    connection.execute(f"PRAGMA user_version = {len(MIGRATIONS) + 1}")
    connection.close()

    with pytest.raises(JournalError, match=r"has version 2, .* use the zensim that wrote it"):
        open_store(tmp_path)


def test_ledger_of_an_older_version_is_brought_up_to_date(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ledger = open_store(tmp_path)
    fill(ledger, {("entity", "a"): b"1"}, 1)
    ledger.close()
    newer = (*MIGRATIONS, "CREATE TABLE more (id INTEGER PRIMARY KEY)")
    monkeypatch.setattr(ledger_module, "MIGRATIONS", newer)

    assert state_of(tmp_path) == (1, 0, {"a": b"1"})
    connection = sqlite3.connect(tmp_path / DATABASE)
    assert connection.execute("PRAGMA user_version").fetchone() == (2,)
    assert connection.execute("SELECT count(*) FROM more").fetchone() == (0,)
    connection.close()


@pytest.mark.parametrize("kind", ["file", "garbage", "no journal"])
def test_ledger_says_in_one_line_what_cannot_be_opened(tmp_path: Path, kind: str) -> None:
    folder = tmp_path / "j"
    if kind == "file":
        folder.write_text("no folder")
    elif kind == "garbage":
        put_there(folder, {DATABASE: b"this is no database" * 100})

    with pytest.raises(JournalError) as caught:
        read(folder) if kind == "no journal" else open_store(folder)

    assert "\n" not in str(caught.value)


def test_ledger_that_lost_its_whole_file_is_not_begun_anew(tmp_path: Path) -> None:
    files = killed(tmp_path / "a", ROWS)
    folder = put_there(tmp_path / "b", {LOCK: files[LOCK]})

    with pytest.raises(JournalError, match="is empty, but 1 changes were written"):
        open_store(folder)


def test_ledger_says_how_many_changes_a_cut_log_lost(tmp_path: Path) -> None:
    one, two = {("entity", "a"): b"1"}, {("entity", "b"): b"2"}
    files = killed(tmp_path / "a", one, two)
    log = files[f"{DATABASE}-wal"]
    folder = put_there(tmp_path / "b", {**files, f"{DATABASE}-wal": log[: len(log) - 100]})

    assert state_of(folder) == (1, 1, {"a": b"1"})


def test_ledger_cut_anywhere_is_a_former_state_or_one_line(tmp_path: Path) -> None:
    batches = [dict(list(ROWS.items())[i * 10 : i * 10 + 10]) for i in range(4)]
    files = killed(tmp_path / "a", *batches)
    states = [
        {key: body for batch in batches[:n] for (_, key), body in batch.items()} for n in range(5)
    ]
    chance = random.Random(1)
    for number in range(CUTS):
        name = chance.choice([DATABASE, f"{DATABASE}-wal"])
        cut = chance.randrange(len(files[name]))
        folder = put_there(tmp_path / f"c{number}", {**files, name: files[name][:cut]})
        assert_consistent(folder, states)


def test_ledger_with_a_flipped_bit_is_a_former_state_or_one_line(tmp_path: Path) -> None:
    batches = [dict(list(ROWS.items())[i * 10 : i * 10 + 10]) for i in range(4)]
    logged = killed(tmp_path / "a", *batches)
    folded = {path.name: path.read_bytes() for path in (tmp_path / "a").iterdir() if path.is_file()}
    states = [
        {key: body for batch in batches[:n] for (_, key), body in batch.items()} for n in range(5)
    ]
    chance = random.Random(2)
    for number in range(FLIPS):
        files = chance.choice([logged, folded])
        name = chance.choice([name for name in files if not name.endswith("-shm")])
        data = bytearray(files[name])
        if data:
            data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
        folder = put_there(tmp_path / f"f{number}", {**files, name: bytes(data)})
        assert_consistent(folder, states)


def assert_consistent(folder: Path, states: list[dict[str, bytes]]) -> None:
    try:
        position, lost, rows = state_of(folder)
    except JournalError as error:
        said = str(error)
    else:
        said = "one line"
        assert rows == states[position]
        assert lost in (0, 4 - position)
    assert "\n" not in said


KEYS = st.sampled_from("abcd")
OPERATIONS = st.lists(st.tuples(KEYS, st.one_of(st.none(), st.binary(max_size=9)), st.booleans()))


@settings(max_examples=25, deadline=None)
@given(operations=OPERATIONS)
def test_ledger_is_whole_after_any_operations(
    tmp_path_factory: pytest.TempPathFactory, operations: list[tuple[str, bytes | None, bool]]
) -> None:
    folder = tmp_path_factory.mktemp("journal")
    ledger, expected = open_store(folder), dict[str, bytes]()
    for position, (key, body, is_kept) in enumerate(operations, start=1):
        ledger.begin()
        if body is None:
            ledger.remove("entity", key)
        else:
            ledger.put("entity", key, body)
        if not is_kept:
            ledger.rollback()
            continue
        ledger.commit(position)
        expected.pop(key, None)
        if body is not None:
            expected[key] = body
    ledger.close()

    assert state_of(folder)[2] == expected
