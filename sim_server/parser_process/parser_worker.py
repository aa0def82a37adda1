"""The sandboxed parser process: no privileges, limited memory and CPU time.

`python -m sim_server.parser_process.parser_worker`: request frames on stdin, result frames on stdout.
"""

import ctypes
import os
import resource
import signal
import sys
from pathlib import Path

import msgspec

from zensim.proto.messages.result_messages import SpawnCode

UNUSED_MODULES = ("embreex", "networkx", "rtree", "scipy.ndimage", "scipy.optimize", "shapely")
"""What trimesh imports where it is there, and uses for nothing that is read here."""

# Half as much again is imported otherwise, before the first robot can come.
if __name__ == "__main__":
    sys.modules.update(dict.fromkeys(UNUSED_MODULES))  # type: ignore[arg-type]

from zensim.sim_server.description.pipeline import (  # noqa: E402
    parse_description,
    parse_world,
    warm_up,
)
from zensim.sim_server.errors import ModelError  # noqa: E402
from zensim.sim_server.parser_process.parser_protocol import (  # noqa: E402
    FRAME_LENGTH,
    ParsedMesh,
    ParseRequest,
    ParseResult,
    ParserReady,
    encode_frame,
)

PR_SET_PDEATHSIG = 1
MAX_MEMORY_BYTES = 1 << 30
"""Address space on top of what the imports took."""
MAX_CPU_S = 10
"""For each request."""
STDIN, STDOUT, STDERR = 0, 1, 2


def main() -> None:
    """Serve until the server closes its end."""
    die_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    answers = os.dup(STDOUT)
    os.dup2(STDERR, STDOUT)
    warm_up()
    drop_privileges()
    write_all(answers, encode_frame(ParserReady()))
    while (frame := read_frame(STDIN)) is not None:
        handle_request(frame, answers)


def die_with_parent() -> None:
    """Ask the kernel to end this process when its parent ends."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


def drop_privileges() -> None:
    """Take away new files, sockets, processes, big files, core dumps, and most memory."""
    most = measure_address_space() + MAX_MEMORY_BYTES
    for kind in (resource.RLIMIT_NOFILE, resource.RLIMIT_FSIZE, resource.RLIMIT_CORE):
        resource.setrlimit(kind, (0, 0))
    resource.setrlimit(resource.RLIMIT_NPROC, (0, 0))
    resource.setrlimit(resource.RLIMIT_AS, (most, most))


def measure_address_space() -> int:
    """Measure this process's address space."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    return pages * resource.getpagesize()


def handle_request(frame: bytes, answers: int) -> None:
    """Answer one request; running out of memory is an answer, too."""
    limit_cpu()
    request = msgspec.msgpack.decode(frame, type=ParseRequest)
    try:
        answer, meshes = parse_request(
            request, {sha256: read_frame(STDIN) or b"" for sha256 in request.files}
        )
        for sha256, data in meshes.items():
            write_all(answers, encode_frame(ParsedMesh(sha256, data)))
    except MemoryError:
        answer = ParseResult(
            request.number,
            None,
            SpawnCode.RESOURCE_PARSE_ERROR,
            slug="reader.memory",
            message=f"reading took more than {MAX_MEMORY_BYTES >> 20} MiB; make the meshes smaller",
        )
    write_all(answers, encode_frame(answer))


FileContents = dict[str, bytes]
MissingUris = dict[str, None]


def parse_request(request: ParseRequest, files: FileContents) -> tuple[ParseResult, FileContents]:
    """Read a robot or a world; find the answer, and the meshes that were made for it."""
    wanted: MissingUris = {}
    try:
        return (parse_world_request if request.is_world else parse_model_request)(
            request, files, wanted
        )
    except ModelError as error:
        message = error.message.removeprefix(f"{error.slug}: ")
        said = (request.number, None, int(error.code), error.slug, message)
        return ParseResult(*said, wanted=tuple(wanted)), {}


def parse_model_request(
    request: ParseRequest, files: FileContents, _: MissingUris
) -> tuple[ParseResult, FileContents]:
    """Read a robot, and make its meshes."""
    described = parse_description(
        request.text,
        assets={ref.uri: (ref.sha256, files.get(ref.sha256)) for ref in request.assets},
        allow_missing=request.allow_missing,
        compat=request.compat,
    )
    model = described.model
    if request.dynamics:
        model = msgspec.structs.replace(model, dynamics=request.dynamics)
    return ParseResult(request.number, model), described.meshes


def parse_world_request(
    request: ParseRequest, files: FileContents, wanted: MissingUris
) -> tuple[ParseResult, FileContents]:
    """Read a world, and make its meshes; note in `wanted` which files it names and lacks."""
    sha256s = {ref.uri: ref.sha256 for ref in request.assets if ref.sha256 in files}

    def find(uri: str) -> tuple[str, bytes] | None:
        if (sha256 := sha256s.get(uri)) is None:
            wanted[uri] = None
            return None
        return sha256, files[sha256]

    def resolve(uri: str) -> str | None:
        found = find(uri)
        return found[1].decode("utf-8", "replace") if found else None

    described = parse_world(
        request.text, resolve=resolve, find_mesh=find, allow_missing=request.allow_missing
    )
    answer = ParseResult(
        request.number,
        world=described.world,
        wanted=tuple(wanted),
        unusable=described.unusable,
    )
    return answer, described.meshes


def limit_cpu() -> None:
    """Allow so many CPU seconds from now on."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    most = int(used.ru_utime + used.ru_stime) + MAX_CPU_S + 1
    resource.setrlimit(resource.RLIMIT_CPU, (most, resource.RLIM_INFINITY))


def read_frame(stream: int) -> bytes | None:
    """Read a frame; None when the other end was closed."""
    if (head := _read_exactly(stream, FRAME_LENGTH.size)) is None:
        return None
    return _read_exactly(stream, FRAME_LENGTH.unpack(head)[0])


def _read_exactly(stream: int, length: int) -> bytes | None:
    parts = []
    while length:
        part = os.read(stream, min(length, 1 << 20))
        if not part:
            return None
        parts.append(part)
        length -= len(part)
    return b"".join(parts)


def write_all(stream: int, data: bytes) -> None:
    """Write everything, however often the pipe is full."""
    left = memoryview(data)
    while left:
        left = left[os.write(stream, left) :]


if __name__ == "__main__":
    main()
