"""The parts of pandas that tests use."""

from pathlib import Path

import numpy as np
import numpy.typing as npt

class Series:
    def to_numpy(self) -> npt.NDArray[np.generic]: ...
    def tolist(self) -> list[object]: ...

class DataFrame:
    def __getitem__(self, key: str) -> Series: ...

def read_parquet(path: Path) -> DataFrame: ...
