"""The folder of a sweep: a file for each run that has ended, and the table of all."""

from collections.abc import Collection, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import BinaryIO

import msgspec

from zensim.deploy.sweep.sweep_plan import SweepPlan
from zensim.deploy.sweep.sweep_rows import SweepRow, make_columns
from zensim.proto.bounded_files import MAX_OWN_FILE_BYTES, read_file
from zensim.proto.whole_files import remove_abandoned, writing_whole
from zensim.recording.recording_parts import remove_recording

FORMAT_VERSION = 1
RUNS, RECORDINGS = "runs", "recordings"
PLAN_FILE = "sweep.json"
TABLE, LINES = "results.parquet", "results.jsonl"


class StoredPlan(msgspec.Struct, frozen=True):
    """What a folder says of its sweep."""

    version: int
    name: str
    file: str
    sha256: str
    paths: tuple[str, ...]
    ids: tuple[str, ...]


class SweepFolder:
    """Reads and writes the files of a sweep; a file has its name only when it is whole."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def open(self, plan: SweepPlan) -> None:
        """Make the folder, and write what the sweep is.

        Raises:
            OSError: A file cannot be written.
        """
        (self.path / RUNS).mkdir(parents=True, exist_ok=True)
        for folder in (self.path, self.path / RUNS):
            remove_abandoned(folder)
        stored = StoredPlan(
            FORMAT_VERSION,
            plan.name,
            plan.file,
            plan.sha256,
            plan.paths,
            tuple(run.id for run in plan.runs),
        )
        self._write(self.path / PLAN_FILE, msgspec.json.encode(stored))

    def read_plan(self) -> StoredPlan:
        """Read what the sweep is.

        Raises:
            OSError: There is no sweep.
            ValueError: The file is damaged, or of another version.
        """
        file = self.path / PLAN_FILE
        try:
            plan = msgspec.json.decode(read_file(file, MAX_OWN_FILE_BYTES), type=StoredPlan)
        except msgspec.DecodeError as error:
            raise ValueError(f"{file} is not that of a sweep: {error}") from error
        if plan.version != FORMAT_VERSION:
            raise ValueError(f"{file} has version {plan.version}, not {FORMAT_VERSION}")
        return plan

    def read_rows(self, ids: Collection[str]) -> list[SweepRow]:
        """Read the rows of runs that have ended, sorted by id; a damaged file is no row."""
        found = (self._read_row(name) for name in sorted(ids))
        return [row for row in found if row is not None]

    def write_row(self, row: SweepRow) -> None:
        """Keep a row; it is there in whole, or not at all, whatever ends this process.

        Raises:
            OSError: It cannot be written.
        """
        self._write(self._find_file(row.id), msgspec.json.encode(row))

    def find_recording(self, run_id: str) -> Path:
        """Find the folder of the recording of a run that fails; each has metadata of its own."""
        return self.path.resolve() / RECORDINGS / run_id

    def remove_recording(self, run_id: str) -> None:
        """Remove the recording of a run, if there is one.

        Raises:
            OSError: It cannot be removed.
        """
        remove_recording(self.find_recording(run_id))

    def write_results(self, rows: Sequence[SweepRow]) -> Path:
        """Write the table of all rows: Parquet, or JSON lines where pyarrow is not installed.

        Raises:
            OSError: It cannot be written.
        """
        has_arrow = find_spec("pyarrow") is not None
        file = self.path / (TABLE if has_arrow else LINES)
        plan = self.read_plan()
        with writing_whole(file) as stream:
            if has_arrow:
                _write_parquet(rows, stream, plan)
            else:
                _write_lines(rows, stream)
        (self.path / (LINES if has_arrow else TABLE)).unlink(missing_ok=True)
        return file

    def _find_file(self, run_id: str) -> Path:
        return self.path / RUNS / f"{run_id}.json"

    def _read_row(self, run_id: str) -> SweepRow | None:
        try:
            data = read_file(self._find_file(run_id), MAX_OWN_FILE_BYTES)
            row = msgspec.json.decode(data, type=SweepRow)
        except (FileNotFoundError, msgspec.DecodeError):
            return None
        return row if row.id == run_id else None

    @staticmethod
    def _write(file: Path, content: bytes) -> None:
        with writing_whole(file) as stream:
            stream.write(content)


def _write_parquet(rows: Sequence[SweepRow], stream: BinaryIO, plan: StoredPlan) -> None:
    import pyarrow as pa  # noqa: PLC0415  120 MB, in an extra
    from pyarrow import parquet  # noqa: PLC0415

    metadata = {"zensim.sweep": msgspec.json.encode(msgspec.structs.replace(plan, ids=()))}
    table = pa.table(make_columns(rows)).replace_schema_metadata(metadata)
    parquet.write_table(table, stream, compression="zstd")


def _write_lines(rows: Sequence[SweepRow], stream: BinaryIO) -> None:
    columns = make_columns(rows)
    lines = (dict(zip(columns, one, strict=True)) for one in zip(*columns.values(), strict=True))
    stream.writelines(msgspec.json.encode(one) + b"\n" for one in lines)
