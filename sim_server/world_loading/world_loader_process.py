"""Loads a world file and its resources in a separate process.

Run with `python -m`: a request on stdin, the result on stdout.
"""

from __future__ import annotations

import signal
import sys
from functools import cache, partial
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from zensim.proto.bounded_files import FileTooLarge, NotRegularFile, read_text_file
from zensim.proto.parent_death import die_with_parent
from zensim.proto.settings.start_settings import USUAL_READING, WorldFileSettings
from zensim.sim_server.description.builtin_models import list_builtin_worlds, read_builtin_world
from zensim.sim_server.description.pipeline import parse_world
from zensim.sim_server.description.strict_xml import MAX_BYTES
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
    from collections.abc import Sequence

MAX_SHOWN_WARNINGS = 5
"""Report entries that an error message repeats."""


def main() -> None:
    """Load the requested world."""
    die_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    request = msgspec.msgpack.decode(sys.stdin.buffer.read(), type=WorldLoaderRequest)
    try:
        loaded = load_world_file(request.name, request.files)
        result = WorldLoaderResult(loaded)
    except ConfigError as error:
        result = WorldLoaderResult(fault=str(error))
    sys.stdout.buffer.write(msgspec.msgpack.encode(result))


def load_world_file(name: str, files: WorldFileSettings = USUAL_READING) -> LoadedWorld:
    """Load a built-in world or a world file, and the models and meshes that it names.

    Args:
        name: Name of a built-in world, or path of a world file.
        files: How it is read; its folder is searched for models and meshes, too.

    Raises:
        ConfigError: There is no such world, or it cannot be parsed.
    """
    folders = [Path(path) for path in files.model_paths]
    parse = partial(_parse_world, allow_missing=files.allow_missing)
    try:
        if name in list_builtin_worlds():
            loaded = parse(read_builtin_world(name), folders)
        else:
            file = Path(name)
            text = read_text_file(file, MAX_BYTES)
            searched = [file.resolve().parent, *folders]
            loaded = parse(text, searched)
    except SimError as error:
        raise ConfigError(f"world '{name}': {error}") from error
    except (FileTooLarge, NotRegularFile) as error:
        raise ConfigError(f"world '{name}' {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"world '{name}' is not UTF-8: {error.reason}; convert it") from error
    except OSError as error:
        if Path(name).is_file():
            raise ConfigError(f"world '{name}' cannot be read: {error.strerror}") from error
        builtin = ", ".join(list_builtin_worlds())
        raise ConfigError(f"world '{name}' is neither a file nor one of {builtin}") from error
    if files.strict:
        _refuse_warnings(name, list_warnings(loaded.model.report))
    return loaded


def _refuse_warnings(name: str, warnings: Sequence[str]) -> None:
    if not warnings:
        return
    more = len(warnings) - MAX_SHOWN_WARNINGS
    raise ConfigError(
        f"world '{name}' is refused by `strict`: {'; '.join(warnings[:MAX_SHOWN_WARNINGS])}"
        + (f"; and {more} more" if more > 0 else "")
    )


def _parse_world(text: str, folders: Sequence[Path], *, allow_missing: bool) -> LoadedWorld:
    read = make_file_reader(folders)

    @cache
    def find_mesh(uri: str) -> tuple[str, bytes] | None:
        data = read(uri)
        return None if data is None else (sha256(data).hexdigest(), data)

    parsed = parse_world(
        text, resolve=make_model_resolver(folders), find_mesh=find_mesh, allow_missing=allow_missing
    )
    return LoadedWorld(parsed.world, parsed.meshes)


if __name__ == "__main__":
    main()
