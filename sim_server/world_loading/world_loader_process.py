"""Loads a world file and its resources in a separate process.

`python -m sim_server.world_loading.world_loader_process`: a request on stdin, the result on stdout.
"""

from __future__ import annotations

import signal
import sys
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from zensim.proto.process_limits import die_with_parent
from zensim.sim_server.description.builtin_models import list_builtin_worlds, read_builtin_world
from zensim.sim_server.description.pipeline import parse_world
from zensim.sim_server.errors import SimError
from zensim.sim_server.server_config import ConfigError
from zensim.sim_server.world_loading.world_loader import (
    LoadedWorld,
    WorldLoaderRequest,
    WorldLoaderResult,
    list_warnings,
)
from zensim.sim_server.world_loading.world_resources import make_file_reader, make_model_resolver

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

MAX_SHOWN_WARNINGS = 5
"""Entries of the report that a refusal repeats."""


def main() -> None:
    """Read the world that is asked for."""
    die_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    order = msgspec.msgpack.decode(sys.stdin.buffer.read(), type=WorldLoaderRequest)
    try:
        loaded = load_world_file(order.name, order.model_paths, is_strict=order.is_strict)
        outcome = WorldLoaderResult(loaded)
    except ConfigError as error:
        outcome = WorldLoaderResult(fault=str(error))
    sys.stdout.buffer.write(msgspec.msgpack.encode(outcome))


def load_world_file(
    name: str, model_paths: Iterable[str] = (), *, is_strict: bool = False
) -> LoadedWorld:
    """Read a shipped world by name, or a world file by path, and the files that it names.

    Args:
        name: Of the world.
        model_paths: Folders to look for models and meshes in, beside that of the world file.
        is_strict: Refuse a world of which something was left out or is suspicious.

    Raises:
        ConfigError: There is none, or it cannot be read.
    """
    folders = [Path(path) for path in model_paths]
    try:
        if name in list_builtin_worlds():
            loaded = _parse_world(read_builtin_world(name), folders)
        else:
            file = Path(name)
            text = file.read_text(encoding="utf-8")
            loaded = _parse_world(text, [file.resolve().parent, *folders])
    except SimError as error:
        raise ConfigError(f"world '{name}': {error}") from error
    except (OSError, UnicodeDecodeError) as error:
        shipped = ", ".join(list_builtin_worlds())
        raise ConfigError(f"world '{name}' is neither a file nor one of {shipped}") from error
    if is_strict and (faults := list_warnings(loaded.model.report)):
        raise ConfigError(
            f"world '{name}' is refused by --strict: {'; '.join(faults[:MAX_SHOWN_WARNINGS])}"
            + (
                f"; and {len(faults) - MAX_SHOWN_WARNINGS} more"
                if len(faults) > MAX_SHOWN_WARNINGS
                else ""
            )
        )
    return loaded


def _parse_world(text: str, folders: Sequence[Path]) -> LoadedWorld:
    read = make_file_reader(folders)

    @cache
    def find_mesh(uri: str) -> tuple[str, bytes] | None:
        data = read(uri)
        return None if data is None else (sha256(data).hexdigest(), data)

    described = parse_world(text, resolve=make_model_resolver(folders), find_mesh=find_mesh)
    return LoadedWorld(described.world, described.meshes)


if __name__ == "__main__":
    main()
