"""The folder of a sweep: whole rows only, and equal tables of equal rows."""

import json
import os
from importlib import util
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from tests.deploy.sweep.sweep_samples import make_sweep_row, write_scenario
from zensim.deploy.sweep.sweep_folder import SweepFolder
from zensim.deploy.sweep.sweep_plan import make_plan


@pytest.fixture
def folder(tmp_path: Path) -> SweepFolder:
    opened = SweepFolder(tmp_path / "short.sweep")
    opened.open(make_plan(write_scenario(tmp_path, "{behaviours.go.v: [0.2, 0.3]}")))
    return opened


def test_row_is_read_back(folder: SweepFolder) -> None:
    row = make_sweep_row("b", margins={"there": None, "slow": -0.5})

    folder.write_row(row)

    assert folder.read_rows(["a", "b"]) == [row]


def test_rows_come_sorted_by_id(folder: SweepFolder) -> None:
    for name in ("c", "a", "b"):
        folder.write_row(make_sweep_row(name))

    assert [row.id for row in folder.read_rows(["b", "c", "a"])] == ["a", "b", "c"]


@pytest.mark.parametrize("content", [b"", b'{"id": "a", "se', b'{"id": "other"}'])
def test_damaged_file_is_no_row(content: bytes, folder: SweepFolder) -> None:
    (folder.path / "runs" / "a.json").write_bytes(content)

    assert folder.read_rows(["a"]) == []


def test_file_that_was_not_renamed_is_no_row_and_is_removed_later(folder: SweepFolder) -> None:
    folder.write_row(make_sweep_row("a"))
    whole = folder.path / "runs" / "a.json"
    left = whole.rename(whole.with_name(".a.json.0123456789abcdef.part"))
    os.utime(left, (1e9, 1e9))

    assert folder.read_rows(["a"]) == []
    folder.open(make_plan(folder.read_plan().file))
    assert not left.exists()


def test_row_that_cannot_be_written_leaves_no_file(folder: SweepFolder) -> None:
    (folder.path / "runs" / "a.json").mkdir()

    with pytest.raises(OSError, match=r"a\.json"):
        folder.write_row(make_sweep_row("a"))

    assert [one.name for one in (folder.path / "runs").iterdir()] == ["a.json"]


def test_row_and_its_name_are_on_the_disk(
    folder: SweepFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: list[int] = []
    monkeypatch.setattr(os, "fsync", lambda handle: synced.append(os.fstat(handle).st_ino))

    folder.write_row(make_sweep_row("a"))

    runs = folder.path / "runs"
    assert synced == [(runs / "a.json").stat().st_ino, runs.stat().st_ino]


def test_results_are_a_table_with_its_sweep(folder: SweepFolder) -> None:
    rows = [make_sweep_row("a", inputs={"v": 0.2}), make_sweep_row("b", is_passed=False)]

    table = pq.read_table(folder.write_results(rows))

    columns = table.to_pydict()
    assert columns["id"] == ["a", "b"]
    assert columns["in.v"] == [0.2, None]
    assert columns["passed"] == [True, False]
    assert json.loads(table.schema.metadata[b"zensim.sweep"])["name"] == "short"


def test_equal_rows_make_equal_bytes(folder: SweepFolder) -> None:
    rows = [make_sweep_row(name, margins={"m": 0.1}) for name in ("a", "b")]

    first = folder.write_results(rows).read_bytes()

    assert folder.write_results(rows).read_bytes() == first


def test_results_are_lines_without_pyarrow(
    folder: SweepFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = folder.write_results([make_sweep_row("a")])
    monkeypatch.setattr("zensim.deploy.sweep.sweep_folder.find_spec", lambda _: None)

    file = folder.write_results([make_sweep_row("a"), make_sweep_row("b")])

    assert util.find_spec("pyarrow") is not None
    assert [json.loads(line)["id"] for line in file.read_text().splitlines()] == ["a", "b"]
    assert file.suffix == ".jsonl"
    assert not found.exists()


def test_folder_without_a_sweep_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        SweepFolder(tmp_path).read_plan()
    (tmp_path / "sweep.json").write_text('{"version": 99}')
    with pytest.raises(ValueError, match="sweep"):
        SweepFolder(tmp_path).read_plan()
