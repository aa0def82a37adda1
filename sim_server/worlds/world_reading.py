"""A world's text on its way through the reader, which asks for the files that the text names."""

from __future__ import annotations

from hashlib import sha256
from typing import TYPE_CHECKING

from zensim.proto.messages.asset_messages import MAX_BUNDLE_BYTES, MAX_BUNDLE_FILES, AssetRef
from zensim.proto.messages.result_messages import SpawnCode
from zensim.sim_server.reading.messages import ReadRequest, TextRead
from zensim.sim_server.worlds.model_path import bytes_in, models_in

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from zensim.sim_server.reading.assets import AssetStore
    from zensim.sim_server.reading.descriptions import Descriptions

MAX_ROUNDS = 20
"""Each may bring models that name others: includes nest 16 deep."""


class WorldReading:
    """Reads one world; files come from the operator's folders and from nowhere else."""

    def __init__(
        self,
        text: str,
        folders: Sequence[Path],
        descriptions: Descriptions,
        store: AssetStore,
        *,
        allow_missing: bool,
    ) -> None:
        self.answer: TextRead | None = None
        """What came of it, once it is over."""
        self._text = text
        self._allow_missing = allow_missing
        self._resolve, self._find = models_in(folders), bytes_in(folders)
        self._descriptions = descriptions
        self._store = store
        self._given: dict[str, str] = {}
        self._given_bytes = self._rounds = 0
        self._is_last = False
        self._submit()

    def _submit(self) -> None:
        self._rounds += 1
        self._descriptions.ask(
            ReadRequest(
                0,
                self._text,
                # Only once there is nothing more to give may something be missing.
                allow_missing=self._is_last,
                assets=tuple(AssetRef(uri, name) for uri, name in self._given.items()),
                files=tuple(dict.fromkeys(self._given.values())),
                is_world=True,
            ),
            self._note,
        )

    def _note(self, answer: TextRead) -> None:
        new = [uri for uri in answer.wanted if uri not in self._given and self._give(uri)]
        if new and self._rounds < MAX_ROUNDS:
            self._submit()
        elif answer.code == SpawnCode.MISSING_ASSETS and self._allow_missing and not self._is_last:
            self._is_last = True
            self._submit()
        else:
            self.answer = answer

    def _give(self, uri: str) -> bool:
        text = self._resolve(uri)
        data = text.encode() if text is not None else self._find(uri)
        if data is None or len(self._given) >= MAX_BUNDLE_FILES:
            return False
        self._given_bytes += len(data)
        if self._given_bytes > MAX_BUNDLE_BYTES:
            return False
        name = sha256(data).hexdigest()
        self._store.keep(name, data)
        self._given[uri] = name
        return True
