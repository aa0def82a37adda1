"""Uploading meshes

Twenty meshes of 20,160 triangles each are uploaded to a server with ten standing robots: collected
and hashed as `zensim spawn` does, sent in pieces, then sent again when the server has all of them.
Floor: the same pieces as requests to a process that only receives them, through the same router.
"""

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec

from benchmarks import large_robot
from benchmarks.echo_process import Echo, echo
from benchmarks.figures import Figure, table
from benchmarks.ten_robots import ROBOTS, ROBOTS_WHEN_SHORT, fleet, milliseconds
from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.messages.asset_messages import (
    MAX_CHUNK_BYTES,
    MissingAssetsRequest,
    MissingAssetsResponse,
    PutAssetRequest,
    PutAssetResponse,
)
from zensim.spawner.spawn.asset_bundle import AssetFile, make_bundle
from zensim.spawner.spawn.search_paths import SearchPaths
from zensim.spawner.spawn.spawn_client import send_files

__all__ = ["rows", "table"]

RUNS = 5
PERCENT = 100.0


class Run(msgspec.Struct, frozen=True):
    """Durations of one bundle [ms]."""

    gather_ms: float
    send_ms: float
    again_ms: float
    floor_ms: float


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure times, then count bytes."""
    count = len(large_robot.ENDINGS) if is_short else large_robot.MESHES
    with fleet(ROBOTS_WHEN_SHORT if is_short else ROBOTS) as found, echo(found.server.bus) as sink:
        runs: list[Run] = []
        for seed in range(1 if is_short else RUNS):
            with TemporaryDirectory() as folder:
                text, paths = _written(Path(folder), seed, count)
                bundle = make_bundle(text, paths)
                gather_ms = milliseconds(partial(make_bundle, text, paths))
                send = partial(send_files, found.server.client, bundle)
                floor_ms = milliseconds(partial(_put, sink, bundle.files))
                runs.append(Run(gather_ms, milliseconds(send), milliseconds(send), floor_ms))
                size, said = sum(file.size for file in bundle.files), _said(bundle.files)
    yield _figure("find the files and name them by content", [run.gather_ms for run in runs])
    yield _figure("send them", [run.send_ms for run in runs])
    yield _figure("floor: send them to a process that only takes them", [r.floor_ms for r in runs])
    yield _figure("send them again", [run.again_ms for run in runs])
    yield Figure(what="files", unit="MB", samples=(size * 1e-6,))
    yield Figure(
        what="sent and received beside them",
        unit="% of the files",
        samples=((said / size - 1.0) * PERCENT,),
    )


def _figure(what: str, samples: Sequence[float]) -> Figure:
    return Figure(what=what, unit="ms", samples=tuple(samples))


def _written(folder: Path, seed: int, count: int) -> tuple[str, SearchPaths]:
    for name, data in large_robot.meshes(seed, count).items():
        folder.joinpath(name).write_bytes(data)
    return large_robot.text(count=count), SearchPaths((folder.resolve(),))


def _put(sink: Echo, files: Sequence[AssetFile]) -> None:
    for piece in _pieces(files):
        sink.put(piece.data)


def _said(files: Sequence[AssetFile]) -> int:
    """Count the bytes of all requests and responses."""
    names = tuple(file.sha256 for file in files)
    messages: list[msgspec.Struct] = [
        MissingAssetsRequest(names),
        MissingAssetsResponse(missing=names, received=(0,) * len(names)),
    ]
    for piece in _pieces(files):
        messages += [piece, PutAssetResponse(received=piece.offset + len(piece.data))]
    return sum(len(encode(message, Format.MSGPACK)) for message in messages)


def _pieces(files: Sequence[AssetFile]) -> Iterator[PutAssetRequest]:
    for file in files:
        data = file.path.read_bytes()
        for offset in range(0, file.size, MAX_CHUNK_BYTES):
            piece = data[offset : offset + MAX_CHUNK_BYTES]
            yield PutAssetRequest(file.sha256, offset, file.size, piece)
