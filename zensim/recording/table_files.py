"""Files of tables: Parquet, CSV or NPZ, with the units of columns."""

import csv
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

import msgspec
import numpy as np

from zensim.proto.printable_text import to_file_name
from zensim.recording.message_columns import Column, TextColumn
from zensim.recording.message_tables import RecordedTable

if TYPE_CHECKING:
    import pyarrow as pa

TableFormat = Literal["parquet", "csv", "npz"]
COLUMNS_FILE: Final = "columns.json"
"""Types, units and numbers of rows of all tables in a folder."""


class MissingDatasetExtra(Exception):
    """The packages of the dataset extra are not installed."""


class TableFacts(msgspec.Struct, frozen=True, kw_only=True):
    """What a file has."""

    file: str
    ros_type: str
    rows: int
    columns: dict[str, str]
    """Unit of each column; empty if it has none."""
    left_out: tuple[str, ...]
    """Columns whose shape differs from message to message."""
    damaged: int
    """Messages that could not be decoded."""


def write_tables(
    tables: Sequence[RecordedTable], folder: Path, table_format: TableFormat
) -> list[TableFacts]:
    """Write a file for each table into a new or empty folder, and `columns.json`.

    Raises:
        OSError: A file cannot be written, or the folder is not empty.
        MissingDatasetExtra: Parquet is asked for, and pyarrow is not installed.
    """
    write = find_writer(table_format)
    folder.mkdir(parents=True, exist_ok=True)
    if any(folder.iterdir()):
        raise FileExistsError(f"{folder} is not empty; give another `output`")
    facts = []
    for table, stem in zip(tables, _name_files(tables), strict=True):
        file = folder / f"{stem}.{table_format}"
        unfinished = folder / f".{stem}.part.{table_format}"
        write(table, unfinished)
        unfinished.rename(file)
        facts.append(_describe(table, file.name))
    content = {Path(one.file).stem: msgspec.to_builtins(one) for one in facts}
    text = json.dumps(content, indent=1) + "\n"
    (folder / COLUMNS_FILE).write_text(text, encoding="utf-8")
    return facts


def find_writer(table_format: TableFormat) -> Callable[[RecordedTable, Path], None]:
    """Find the function that writes a table.

    Raises:
        MissingDatasetExtra: pyarrow is not installed.
    """
    if table_format != "parquet":
        return write_csv if table_format == "csv" else write_npz
    try:
        import pyarrow.parquet  # noqa: F401, PLC0415  170 MB, in an extra
    except ModuleNotFoundError as error:
        raise MissingDatasetExtra(
            "pyarrow is not installed; use pip install 'zensim[dataset]', or `to` csv"
        ) from error
    return write_parquet


def _name_files(tables: Sequence[RecordedTable]) -> list[str]:
    """Name files by tables, and by types where a name has several; no two are equal.

    Names are those of topics, in which `a/b` and `a_b` differ.
    """
    names = [table.name for table in tables]
    found: dict[str, str] = {}
    for table in tables:
        is_only = names.count(table.name) == 1
        stem = to_file_name(table.name if is_only else f"{table.name}_{table.ros_type}")
        number = 1
        while (name := stem if number == 1 else f"{stem}_{number}").casefold() in found:
            number += 1
        found[name.casefold()] = name
    return list(found.values())


def _describe(table: RecordedTable, file: str) -> TableFacts:
    units = table.units
    return TableFacts(
        file=file,
        ros_type=table.ros_type,
        rows=len(table),
        columns={path: units.get(path, "") for path in table.columns},
        left_out=table.left_out,
        damaged=table.damaged,
    )


def write_parquet(table: RecordedTable, file: Path) -> None:
    """Write a table with Zstandard; texts are dictionaries, units are metadata of the fields.

    Raises:
        OSError: The file cannot be written.
    """
    import pyarrow as pa  # noqa: PLC0415
    from pyarrow import parquet  # noqa: PLC0415

    arrays, fields = [], []
    for path, column in table.columns.items():
        array = _to_arrow(column)
        unit = table.units.get(path)
        arrays.append(array)
        fields.append(pa.field(path, array.type, metadata={"unit": unit} if unit else None))
    metadata = {"ros_type": table.ros_type}
    content = pa.Table.from_arrays(arrays, schema=pa.schema(fields, metadata=metadata))
    parquet.write_table(content, file, compression="zstd")


def _to_arrow(column: Column) -> "pa.Array":
    import pyarrow as pa  # noqa: PLC0415

    if isinstance(column, TextColumn):
        return pa.DictionaryArray.from_arrays(column.codes, list(column.texts))
    if column.ndim == 1:
        return pa.array(column)
    flat = pa.array(np.ascontiguousarray(column).reshape(-1))
    return pa.FixedSizeListArray.from_arrays(flat, column.shape[1])


def write_csv(table: RecordedTable, file: Path) -> None:
    """Write a table with a head line; arrays have a column for each item.

    Raises:
        OSError: The file cannot be written.
    """
    columns = dict(_flatten(table.columns))
    with file.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))


def _flatten(columns: Mapping[str, Column]) -> list[tuple[str, list[object]]]:
    found: list[tuple[str, list[object]]] = []
    for path, column in columns.items():
        if isinstance(column, TextColumn):
            found.append((path, [*column.to_list()]))
        elif column.ndim == 1:
            found.append((path, column.tolist()))
        else:
            found += [(f"{path}[{one}]", column[:, one].tolist()) for one in range(column.shape[1])]
    return found


def write_npz(table: RecordedTable, file: Path) -> None:
    """Write a table as compressed NumPy arrays.

    Raises:
        OSError: The file cannot be written.
    """
    arrays = {
        path: np.array(column.to_list()) if isinstance(column, TextColumn) else column
        for path, column in table.columns.items()
    }
    np.savez_compressed(file, **arrays)  # type: ignore[arg-type]  # a path may be `file`
