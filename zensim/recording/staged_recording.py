"""A recording that appears under its name as soon as it is whole."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import mkdtemp

from zensim.recording.recording_parts import METADATA_FILE, SUFFIX, require_new


@contextmanager
def staged_recording(path: Path) -> Iterator[Path]:
    """Give a path to write to; what is there gets its name when the block ends without an error.

    Until then it is in a hidden folder beside, which is removed after an error.

    Args:
        path: A file with suffix `.mcap`, or a folder; must not exist.

    Raises:
        FileExistsError: It exists, or a file of the recording does when it is whole.
        OSError: It cannot be written.
    """
    require_new(path)
    if path.suffix != SUFFIX:
        path.parent.mkdir(parents=True, exist_ok=True)
    folder = Path(mkdtemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent))
    try:
        yield folder / path.name
        _name_files(folder, path)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _name_files(folder: Path, path: Path) -> None:
    if path.suffix != SUFFIX:
        require_new(path)
        (folder / path.name).rename(path)
        return
    target = path.parent
    # The file that was asked for comes last: where it is, all others are.
    files = sorted(folder.glob(f"*{SUFFIX}"), key=lambda one: one.name == path.name)
    for one in files:
        require_new(target / one.name)
    for one in files:
        one.rename(target / one.name)
    metadata = folder / METADATA_FILE
    if metadata.exists() and not (target / METADATA_FILE).exists():
        metadata.rename(target / METADATA_FILE)
