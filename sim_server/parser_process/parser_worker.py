"""The sandboxed parser process: no privileges, limited memory and CPU time.

Run with `python -m`: request frames on stdin, result frames on stdout.
"""

import signal
from contextlib import suppress

import msgspec

from zensim.proto.child_process import STDIN, read_frame, reserve_stdout, write_frame
from zensim.proto.messages.result_messages import SpawnCode
from zensim.proto.parent_death import die_with_parent
from zensim.proto.process_limits import ResourceLimits, allow_cpu_time, set_resource_limits
from zensim.sim_server.description.unused_modules import leave_out_unused_modules

if __name__ == "__main__":
    leave_out_unused_modules()

from zensim.sim_server.description.pipeline import parse_description, parse_world, warm_up
from zensim.sim_server.errors import ModelError
from zensim.sim_server.parser_process.parser_protocol import (
    MAX_CPU_S,
    ParsedMesh,
    ParseRequest,
    ParseResult,
    ParserReady,
)
from zensim.sim_server.parser_process.renamed_texts import RenamedTexts

MAX_MEMORY_BYTES = 1 << 30
LIMITS = ResourceLimits(extra_memory_bytes=MAX_MEMORY_BYTES, is_sandboxed=True)


def main() -> None:
    """Handle requests until the server closes stdin."""
    die_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    replies = reserve_stdout()
    warm_up()
    set_resource_limits(LIMITS)
    texts = RenamedTexts(lambda request: parse_request(request, {}))
    write_frame(replies, msgspec.msgpack.encode(ParserReady()))
    while (frame := read_frame(STDIN)) is not None:
        handle_request(frame, replies, texts)


def handle_request(frame: bytes, replies: int, texts: RenamedTexts) -> None:
    """Reply to one request, also when memory runs out."""
    allow_cpu_time(MAX_CPU_S)
    request = msgspec.msgpack.decode(frame, type=ParseRequest)
    try:
        if request.is_world or request.files:
            files = {sha256: read_frame(STDIN) or b"" for sha256 in request.files}
            result, meshes = parse_request(request, files)
        else:
            result, meshes = texts.parse(request)
        for sha256, data in meshes.items():
            write_frame(replies, msgspec.msgpack.encode(ParsedMesh(sha256, data)))
    except MemoryError:
        result = ParseResult(
            request.number,
            None,
            SpawnCode.RESOURCE_PARSE_ERROR,
            slug="reader.memory",
            message=f"parsing took more than {MAX_MEMORY_BYTES >> 20} MiB; make the meshes smaller",
        )
    write_frame(replies, msgspec.msgpack.encode(result))
    with suppress(MemoryError):
        texts.check()


FileContents = dict[str, bytes]
MissingUris = dict[str, None]


def parse_request(request: ParseRequest, files: FileContents) -> tuple[ParseResult, FileContents]:
    """Parse a robot or a world; return the result and its meshes by sha256."""
    wanted: MissingUris = {}
    try:
        return (parse_world_request if request.is_world else parse_model_request)(
            request, files, wanted
        )
    except ModelError as error:
        message = error.message.removeprefix(f"{error.slug}: ")
        refusal = ParseResult(
            request.number,
            code=int(error.code),
            slug=error.slug,
            message=message,
            wanted=tuple(wanted),
        )
        return refusal, {}


def parse_model_request(
    request: ParseRequest, files: FileContents, _: MissingUris
) -> tuple[ParseResult, FileContents]:
    """Parse a robot and convert its meshes."""
    described = parse_description(
        request.text,
        assets={ref.uri: (ref.sha256, files.get(ref.sha256)) for ref in request.assets},
        allow_missing=request.allow_missing,
        compat=request.compat,
        controllers=request.controllers,
        drive=request.drive,
    )
    model = described.model
    if request.dynamics:
        model = msgspec.structs.replace(model, dynamics=request.dynamics)
    return ParseResult(request.number, model), described.meshes


def parse_world_request(
    request: ParseRequest, files: FileContents, wanted: MissingUris
) -> tuple[ParseResult, FileContents]:
    """Parse a world and convert its meshes; add the URIs of missing files to `wanted`."""
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
    result = ParseResult(
        request.number, world=described.world, wanted=tuple(wanted), unusable=described.unusable
    )
    return result, described.meshes


if __name__ == "__main__":
    main()
