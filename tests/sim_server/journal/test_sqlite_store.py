"""Committed rows are durable, and damage of the files is detected."""

import random
import sqlite3
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from zensim.sim_server.journal import sqlite_store
from zensim.sim_server.journal.sqlite_store import (
    COPIES,
    DATABASE,
    FILES,
    FIRST_VERSION,
    LOCK,
    MIGRATIONS,
    WRITER_ROW,
    JournalError,
    SqliteStore,
    count_unchecked_rows,
    open_store,
    open_store_read_only,
)

CUTS = 60
FLIPS = 120
ROWS = {("entity", f"r{i}"): f"row {i}".encode() * 20 for i in range(40)}


def fill(store: SqliteStore, rows: dict[tuple[str, str], bytes], position: int) -> None:
    store.begin()
    for (kind, key), body in rows.items():
        store.put(kind, key, body)
    store.commit(position)


def write_and_crash(folder: Path, *batches: dict[tuple[str, str], bytes]) -> dict[str, bytes]:
    """Copy the files of a journal before it is closed: the newest changes are in the log."""
    store = open_store(folder)
    for position, rows in enumerate(batches, start=1):
        fill(store, rows, position)
    files = {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}
    store.close()
    return files


def write_files(folder: Path, files: dict[str, bytes]) -> Path:
    (folder / FILES).mkdir(parents=True)
    for name, data in files.items():
        if not name.endswith("-shm"):
            (folder / name).write_bytes(data)
    return folder


def read_state(folder: Path) -> tuple[int, int, dict[str, bytes]]:
    store = open_store(folder)
    try:
        return store.position, store.lost, store.rows("entity")
    finally:
        store.close()


def read(folder: Path) -> None:
    with open_store_read_only(folder):
        pass


def test_store_has_committed_rows_when_opened_again(tmp_path: Path) -> None:
    store = open_store(tmp_path / "j")
    fill(store, {("entity", "a"): b"1", ("entity", "b"): b"2"}, 7)
    store.begin()
    store.remove("entity", "a")
    store.put("entity", "b", b"3")
    store.commit(8)
    store.close()

    assert read_state(tmp_path / "j") == (8, 0, {"b": b"3"})


def test_rows_are_counted_before_a_journal_is_opened(tmp_path: Path) -> None:
    files = write_and_crash(tmp_path / "j", ROWS, {("clock", ""): b"1"})
    folder = write_files(tmp_path / "crashed", files)

    assert count_unchecked_rows(folder, "entity") == len(ROWS)
    assert read_state(folder)[:2] == (2, 0)
    assert count_unchecked_rows(tmp_path / "none", "entity") == 0


def test_rows_of_a_damaged_database_count_as_none(tmp_path: Path) -> None:
    (tmp_path / DATABASE).write_bytes(b"no database" * 500)

    assert count_unchecked_rows(tmp_path, "entity") == 0


def test_store_has_no_rows_that_were_rolled_back(tmp_path: Path) -> None:
    store = open_store(tmp_path)
    fill(store, {("entity", "a"): b"1"}, 1)
    store.begin()
    store.put("entity", "a", b"2")
    store.put("entity", "b", b"3")
    store.remove("entity", "a")
    store.rollback()
    fill(store, {("entity", "c"): b"4"}, 2)
    store.close()

    assert read_state(tmp_path) == (2, 0, {"a": b"1", "c": b"4"})


def test_store_is_locked_for_a_second_server(tmp_path: Path) -> None:
    first = open_store(tmp_path)

    with pytest.raises(JournalError):
        open_store(tmp_path)

    first.close()
    open_store(tmp_path).close()


def test_store_can_be_read_while_a_server_writes(tmp_path: Path) -> None:
    store = open_store(tmp_path)
    fill(store, {("entity", "a"): b"1"}, 1)

    with open_store_read_only(tmp_path) as reader:
        fill(store, {("entity", "b"): b"2"}, 2)

        assert reader.rows("entity") == {"a": b"1"}
    store.close()


def test_store_of_a_newer_version_is_refused(tmp_path: Path) -> None:
    open_store(tmp_path).close()
    connection = sqlite3.connect(tmp_path / DATABASE)
    connection.execute(f"PRAGMA user_version = {len(MIGRATIONS) + 1}")
    connection.close()

    with pytest.raises(JournalError):
        open_store(tmp_path)


def test_store_of_an_older_version_is_migrated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = open_store(tmp_path)
    fill(store, {("entity", "a"): b"1"}, 1)
    store.close()
    newer = (*MIGRATIONS, "CREATE TABLE more (id INTEGER PRIMARY KEY)")
    monkeypatch.setattr(sqlite_store, "MIGRATIONS", newer)

    assert read_state(tmp_path) == (1, 0, {"a": b"1"})
    connection = sqlite3.connect(tmp_path / DATABASE)
    assert connection.execute("PRAGMA user_version").fetchone() == (2,)
    assert connection.execute("SELECT count(*) FROM more").fetchone() == (0,)
    connection.close()


def test_copy_that_is_kept_before_a_migration_opens_in_the_older_version(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = open_store(tmp_path / "j")
    fill(store, {("entity", "a"): b"1"}, 1)
    store.close()
    newer = (*MIGRATIONS, "CREATE TABLE more (id INTEGER PRIMARY KEY)")
    with monkeypatch.context() as later:
        later.setattr(sqlite_store, "MIGRATIONS", newer)
        read_state(tmp_path / "j")

    (older,) = (tmp_path / "j" / COPIES).iterdir()

    assert read_state(older) == (1, 0, {"a": b"1"})


def test_store_of_another_version_is_copied_before_it_is_changed(tmp_path: Path) -> None:
    store = open_store(tmp_path, "0.2.0")
    (tmp_path / FILES / "mesh.stl").write_bytes(b"solid")
    fill(store, {("entity", "a"): b"1"}, 1)
    store.close()

    newer = open_store(tmp_path, "0.3.0")
    fill(newer, {("entity", "b"): b"2"}, 2)
    newer.close()

    copy = tmp_path / COPIES / "0.2.0"
    assert read_state(tmp_path) == (2, 0, {"a": b"1", "b": b"2"})
    with open_store_read_only(copy) as kept:
        assert (kept.rows("entity"), kept.loss) == ({"a": b"1"}, "")
        assert kept.read_writer() == "0.2.0"
    assert (copy / FILES / "mesh.stl").read_bytes() == b"solid"


def test_store_of_a_killed_server_of_another_version_is_copied_with_its_log(tmp_path: Path) -> None:
    files = write_and_crash(tmp_path / "used", ROWS)
    folder = write_files(tmp_path / "killed", files)

    open_store(folder, "99.0").close()

    (copy,) = (folder / COPIES).iterdir()
    with open_store_read_only(copy) as kept:
        assert len(kept.rows("entity")) == len(ROWS)
        assert kept.loss == ""


def test_store_is_copied_once_for_each_version_that_used_it(tmp_path: Path) -> None:
    for writer in ("1.0", "1.0", "1.1", "1.1", "1.0", "1.1"):
        store = open_store(tmp_path, writer)
        fill(store, {("entity", writer): b"1"}, store.position + 1)
        store.close()

    assert sorted(path.name for path in (tmp_path / COPIES).iterdir()) == ["1.0", "1.1"]
    with open_store_read_only(tmp_path / COPIES / "1.0") as kept:
        assert kept.position == 5


def test_store_without_a_version_is_one_of_the_first(tmp_path: Path) -> None:
    store = open_store(tmp_path)
    store.begin()
    store.remove(*WRITER_ROW)
    store.commit(1)
    store.close()

    with open_store_read_only(tmp_path) as reader:
        assert reader.read_writer() == FIRST_VERSION


def test_store_is_not_changed_when_it_cannot_be_copied(tmp_path: Path) -> None:
    open_store(tmp_path, "1.0").close()
    (tmp_path / COPIES).write_text("a file where the folder belongs")
    before = (tmp_path / DATABASE).read_bytes()

    with pytest.raises(JournalError):
        open_store(tmp_path, "1.1")

    assert (tmp_path / DATABASE).read_bytes() == before
    open_store(tmp_path, "1.0").close()


@pytest.mark.parametrize("name", [b"../../x", b".", b"", b"\xff", b"a/b"])
def test_store_with_a_version_that_is_no_name_is_refused(tmp_path: Path, name: bytes) -> None:
    store = open_store(tmp_path)
    store.begin()
    store.put(*WRITER_ROW, name)
    store.commit(1)
    store.close()

    with pytest.raises(JournalError):
        open_store(tmp_path)

    assert not (tmp_path / COPIES).exists()


@pytest.mark.parametrize("kind", ["file", "garbage", "no journal"])
def test_files_that_are_not_a_store_are_refused_in_one_line(tmp_path: Path, kind: str) -> None:
    folder = tmp_path / "j"
    if kind == "file":
        folder.write_text("no folder")
    elif kind == "garbage":
        write_files(folder, {DATABASE: b"this is no database" * 100})

    with pytest.raises(JournalError) as caught:
        read(folder) if kind == "no journal" else open_store(folder)

    assert "\n" not in str(caught.value)


def test_store_without_its_database_is_not_created_again(tmp_path: Path) -> None:
    files = write_and_crash(tmp_path / "a", ROWS)
    folder = write_files(tmp_path / "b", {LOCK: files[LOCK]})

    with pytest.raises(JournalError):
        open_store(folder)


def test_store_counts_changes_lost_with_a_truncated_log(tmp_path: Path) -> None:
    one, two = {("entity", "a"): b"1"}, {("entity", "b"): b"2"}
    files = write_and_crash(tmp_path / "a", one, two)
    log = files[f"{DATABASE}-wal"]
    folder = write_files(tmp_path / "b", {**files, f"{DATABASE}-wal": log[: len(log) - 100]})

    assert read_state(folder) == (1, 1, {"a": b"1"})


def test_truncated_store_has_a_former_state_or_is_refused_in_one_line(tmp_path: Path) -> None:
    batches = [dict(list(ROWS.items())[i * 10 : i * 10 + 10]) for i in range(4)]
    files = write_and_crash(tmp_path / "a", *batches)
    states = [
        {key: body for batch in batches[:n] for (_, key), body in batch.items()} for n in range(5)
    ]
    chance = random.Random(1)
    for number in range(CUTS):
        name = chance.choice([DATABASE, f"{DATABASE}-wal"])
        cut = chance.randrange(len(files[name]))
        folder = write_files(tmp_path / f"c{number}", {**files, name: files[name][:cut]})
        assert_consistent(folder, states)


def test_store_with_a_flipped_bit_has_a_former_state_or_is_refused_in_one_line(
    tmp_path: Path,
) -> None:
    batches = [dict(list(ROWS.items())[i * 10 : i * 10 + 10]) for i in range(4)]
    logged = write_and_crash(tmp_path / "a", *batches)
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
        folder = write_files(tmp_path / f"f{number}", {**files, name: bytes(data)})
        assert_consistent(folder, states)


def assert_consistent(folder: Path, states: list[dict[str, bytes]]) -> None:
    try:
        position, lost, rows = read_state(folder)
    except JournalError as error:
        message = str(error)
    else:
        message = ""
        assert rows == states[position]
        assert lost in (0, 4 - position)
    assert "\n" not in message


KEYS = st.sampled_from("abcd")
OPERATIONS = st.lists(st.tuples(KEYS, st.one_of(st.none(), st.binary(max_size=9)), st.booleans()))


@settings(max_examples=25, deadline=None)
@given(operations=OPERATIONS)
def test_store_is_consistent_after_any_operations(
    tmp_path_factory: pytest.TempPathFactory, operations: list[tuple[str, bytes | None, bool]]
) -> None:
    folder = tmp_path_factory.mktemp("journal")
    store, expected = open_store(folder), dict[str, bytes]()
    for position, (key, body, is_committed) in enumerate(operations, start=1):
        store.begin()
        if body is None:
            store.remove("entity", key)
        else:
            store.put("entity", key, body)
        if not is_committed:
            store.rollback()
            continue
        store.commit(position)
        expected.pop(key, None)
        if body is not None:
            expected[key] = body
    store.close()

    assert read_state(folder)[2] == expected


@pytest.mark.parametrize("is_locked", [True, False])
@pytest.mark.parametrize("log", [None, b""])
def test_copy_without_its_log_is_reported_by_all_that_open_it(
    tmp_path: Path, log: bytes | None, *, is_locked: bool
) -> None:
    files = write_and_crash(tmp_path / "used", ROWS, {("entity", "last"): b"row"})
    files.pop(f"{DATABASE}-wal")
    if log is not None:
        files[f"{DATABASE}-wal"] = log
    if not is_locked:
        files.pop(LOCK)
    copy = write_files(tmp_path / "copy", files)

    with open_store_read_only(copy) as shown:
        assert shown.is_log_missing
        assert shown.loss
        position = shown.position
    with pytest.raises(JournalError, match="--accept-loss"):
        open_store(copy)
    open_store(copy, accepts_loss=True).close()
    continued = open_store(copy)
    assert continued.loss == ""
    assert continued.position == position
    continued.close()


def test_whole_copies_are_not_reported(tmp_path: Path) -> None:
    files = write_and_crash(tmp_path / "used", ROWS)
    killed = write_files(tmp_path / "killed", files)

    for folder in (killed, tmp_path / "used"):
        with open_store_read_only(folder) as shown:
            assert shown.loss == ""
        store = open_store(folder)
        assert store.loss == ""
        store.close()


def test_database_alone_has_what_a_checkpoint_copied(tmp_path: Path) -> None:
    store = open_store(tmp_path / "used")
    fill(store, ROWS, 1)
    store.checkpoint()
    fill(store, {("entity", "last"): b"row"}, 2)
    data = (tmp_path / "used" / DATABASE).read_bytes()
    store.close()
    copy = write_files(tmp_path / "copy", {DATABASE: data})

    with open_store_read_only(copy) as shown:
        assert shown.position == 1
        assert len(shown.rows("entity")) == len(ROWS)
        assert shown.is_log_missing
