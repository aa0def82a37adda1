"""Files that clients request: meshes of the server, and files that descriptions name."""

import re
import time
from hashlib import sha256
from threading import Lock
from typing import Final

from zensim.foxglove.scene_entities import MESH_URL
from zensim.proto.bus.bus_session import Bus
from zensim.proto.messages.asset_messages import MAX_FILE_BYTES, GetAssetRequest
from zensim.proto.service_catalog import GET_ASSET
from zensim.spawner.client.service_client import ServiceClient

CALL_TIMEOUT_S: Final = 5.0
QUESTION_PERIOD_S: Final = 0.5
"""Least time between two calls for the files of descriptions."""
CACHE_BYTES: Final = 128 << 20
_MESH_ADDRESS: Final = re.compile(re.escape(MESH_URL).replace(r"\{\}", "([0-9a-f]{64})"))


class MeshFiles:
    """Reads files of one world; the last ones are kept. Several threads may read."""

    def __init__(self, bus: Bus, world: str) -> None:
        self._bus, self._world = bus, world
        self._kept: dict[str, bytes] = {}
        self._keeping = Lock()
        self._named: dict[str, str] = {}
        self._next_question_s = 0.0

    def read(self, uri: str) -> bytes:
        """Read a file.

        Raises:
            FileNotFoundError: There is none at this address.
            ServiceError: The server does not have it.
            BusError: No server is running.
            TimeoutError: It does not reply in time.
        """
        found = _MESH_ADDRESS.fullmatch(uri)
        name = found[1] if found is not None else self._find_named(uri)
        if not name:
            raise FileNotFoundError(f"no description names {uri[:200]!r}")
        content = self._kept.get(name)
        if content is None:
            content = self._download(name)
            self._keep(name, content)
        return content

    def _find_named(self, uri: str) -> str:
        """Find the sha256 of a file that a description names; the newest, if several do."""
        if uri not in self._named:
            # Clients may ask for a thousand files that are not there.
            time.sleep(max(0.0, self._next_question_s - time.monotonic()))
            self._next_question_s = time.monotonic() + QUESTION_PERIOD_S
            client = ServiceClient(self._bus, self._world, CALL_TIMEOUT_S)
            models = client.models(wants_descriptions=True)
            self._named = {one.uri: one.sha256 for of in models.files for one in of.files}
        return self._named.get(uri, "")

    def _download(self, name: str) -> bytes:
        content = b""
        while True:
            part = self._bus.call(
                GET_ASSET,
                GetAssetRequest(name, len(content)),
                world=self._world,
                timeout_s=CALL_TIMEOUT_S,
            )
            content += part.data
            is_whole = not part.data or len(content) >= part.total
            if is_whole or part.total > MAX_FILE_BYTES:
                break
        if sha256(content).hexdigest() != name:
            raise FileNotFoundError(f"the file {name} did not arrive whole; try again")
        return content

    def _keep(self, name: str, content: bytes) -> None:
        with self._keeping:
            kept = {**self._kept, name: content}
            while sum(map(len, kept.values())) > CACHE_BYTES and len(kept) > 1:
                del kept[next(iter(kept))]
            self._kept = kept
