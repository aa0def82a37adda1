"""A parser in this process, for trusted descriptions: no sandbox, no process, no deadline."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import msgspec

from zensim.sim_server.parser_process.parser_protocol import ParsedMesh, ParseRequest, ParseResult
from zensim.sim_server.parser_process.parser_worker import parse_request

if TYPE_CHECKING:
    from zensim.sim_server.parser_process.parser_client import AssetSource

MAX_CACHED_RESULTS = 64
"""Results of all worlds of this process."""


class InProcessParser:
    """Parses at once, as the parser process does; worlds of one process share the results."""

    def __init__(self, files: AssetSource) -> None:
        """Take the source of the files that requests name."""
        self._files = files
        self._messages: list[ParsedMesh | ParseResult] = []

    def submit(self, request: ParseRequest) -> None:
        """Parse a text."""
        same = msgspec.structs.replace(request, number=0)
        result, meshes = _parse_once(_EqualRequest(same, self._files))
        self._messages += [ParsedMesh(name, data) for name, data in meshes.items()]
        self._messages.append(msgspec.structs.replace(result, number=request.number))

    def poll(self) -> list[ParsedMesh | ParseResult]:
        """Take the messages of all requests."""
        messages, self._messages = self._messages, []
        return messages


class _EqualRequest:
    """A request, equal to others with the same bytes; files have their content as name."""

    def __init__(self, request: ParseRequest, files: AssetSource) -> None:
        self.request = request
        self.files = files

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _EqualRequest) and self.request == other.request

    def __hash__(self) -> int:
        return hash((self.request.text, self.request.assets, self.request.is_world))


@lru_cache(maxsize=MAX_CACHED_RESULTS)
def _parse_once(wanted: _EqualRequest) -> tuple[ParseResult, dict[str, bytes]]:
    contents = {name: wanted.files.read(name, 0, -1) for name in wanted.request.files}
    return parse_request(wanted.request, contents)
