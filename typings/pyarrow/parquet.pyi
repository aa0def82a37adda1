"""The parts of pyarrow.parquet that zensim uses."""

from pathlib import Path
from typing import BinaryIO

from pyarrow import Table

def read_table(source: Path) -> Table: ...
def write_table(table: Table, where: Path | BinaryIO, *, compression: str) -> None: ...
