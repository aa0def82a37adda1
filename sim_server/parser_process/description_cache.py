"""Models parsed from spawn requests, each parsed once by the parser process and cached."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple, Protocol

import msgspec

from zensim.proto.messages.asset_messages import MAX_BUNDLE_BYTES, MAX_BUNDLE_FILES, AssetRef
from zensim.sim_server.description.builtin_models import resolve_resource
from zensim.sim_server.errors import ModelError
from zensim.sim_server.parser_process.parser_protocol import ParsedMesh, ParseRequest, ParseResult

if TYPE_CHECKING:
    from collections.abc import Callable

    from zensim.proto.messages.model_messages import Dynamics, Model
    from zensim.proto.messages.spawn_messages import Compat, SpawnEntityOrder
    from zensim.sim_server.parser_process.asset_store import AssetStore
    from zensim.sim_server.parser_process.parser_client import ParserClient

MAX_CACHED_MODELS = 512
MAX_CACHED_CHARACTERS = 64 << 20
MAX_MESHES_AT_ONCE = 16
"""Collisions: so many hulls are made in a moment, be they of one mesh or of many."""
REST_RATIO = 2
TRANSIENT_SLUGS = frozenset({"reader.crashed", "reader.timeout"})
"""Faults that another try may not have."""


class ParseKey(NamedTuple):
    """What is read: the same reading gives the same model."""

    text: str
    compat: Compat
    allow_missing: bool
    assets: tuple[AssetRef, ...]
    dynamics: Dynamics = ""


@dataclass
class CachedModel:
    """A model, and the files that it names by sha256."""

    model: Model
    meshes: frozenset[str]
    is_prepared: bool
    """Whether the engine can take it between two steps."""
    unread_meshes: list[str] = field(default_factory=list)
    """Meshes whose corners have to be read before; a spawn asks for them."""


class DescriptionProvider(Protocol):
    """Gives the model that a spawn asks for."""

    def is_read(self, order: SpawnEntityOrder) -> bool:
        """Whether `model` can answer now; if not, reading is under way."""

    def model(self, order: SpawnEntityOrder) -> tuple[Model, str]:
        """Find the model and its text.

        Raises:
            ModelError: The description cannot be used.
        """

    def poll(self) -> bool:
        """Go on; say whether something was read."""

    def find_parse_key(self, model: Model) -> ParseKey | None:
        """Find what a model was read from, if that is still known."""

    def remember(self, reading: ParseKey, model: Model) -> None:
        """Take over what another server has read."""

    def ask(self, request: ParseRequest, on_read: Callable[[ParseResult], None]) -> None:
        """Have a text read besides; `poll` calls with the answer, once what it names is kept.

        Args:
            request: What to read; its number is chosen here.
            on_read: Told once.
        """


class DescriptionCache:
    """Descriptions that the reader process reads."""

    def __init__(
        self,
        reader: ParserClient,
        store: AssetStore,
        prepare: Callable[[Model], bool],
        now_ns: Callable[[], int],
    ) -> None:
        self._reader = reader
        self._store = store
        self._prepare = prepare
        self._now_ns = now_ns
        self._rest_until_ns = 0
        self._unprepared: list[CachedModel] = []
        self._read: OrderedDict[ParseKey, CachedModel | ModelError] = OrderedDict()
        self._pending_keys: dict[int, ParseKey] = {}
        self._numbers: dict[ParseKey, int] = {}
        self._transient: list[ParseKey] = []
        self._asked: dict[int, Callable[[ParseResult], None]] = {}
        self._next_number = 1

    def is_read(self, order: SpawnEntityOrder) -> bool:
        """See `DescriptionProvider`."""
        try:
            reading = self._reading_of(order)
        except ModelError:
            return True
        if not self._is_usable(reading) and reading not in self._numbers:
            self._submit(reading)
        found = self._read.get(reading)
        return found.is_prepared if isinstance(found, CachedModel) else found is not None

    def model(self, order: SpawnEntityOrder) -> tuple[Model, str]:
        """See `DescriptionProvider`."""
        reading = self._reading_of(order)
        found = self._read[reading]
        if isinstance(found, ModelError):
            raise found
        self._read.move_to_end(reading)
        for mesh in found.meshes:
            self._store.size(mesh)  # so that it is not the first to go
        return found.model, reading.text

    def poll(self) -> bool:
        """See `DescriptionProvider`."""
        # Whoever waited for it has been told by now.
        for reading in self._transient:
            self._read.pop(reading, None)
        self._transient.clear()
        messages = self._reader.poll()
        for message in messages:
            if isinstance(message, ParsedMesh):
                self._store.keep(message.sha256, message.data)
            else:
                self._note(message)
        return self._prepare_next() or bool(messages)

    def find_parse_key(self, model: Model) -> ParseKey | None:
        """See `DescriptionProvider`."""
        for reading, found in reversed(self._read.items()):
            if isinstance(found, CachedModel) and found.model is model:
                return reading
        return None

    def remember(self, reading: ParseKey, model: Model) -> None:
        """See `DescriptionProvider`."""
        if reading not in self._read:
            self._keep(reading, self._make_parsed_model(model))

    def _prepare_next(self) -> bool:
        """Prepare a part of a large model, and rest for twice as long: steps come first."""
        if not self._unprepared or (start_ns := self._now_ns()) < self._rest_until_ns:
            return False
        read = self._unprepared[0]
        read.is_prepared = not self._read_next_corners(read) and self._prepare(read.model)
        end_ns = self._now_ns()
        self._rest_until_ns = end_ns + REST_RATIO * (end_ns - start_ns)
        if read.is_prepared:
            self._unprepared.pop(0)
        return read.is_prepared

    def _read_next_corners(self, read: CachedModel) -> bool:
        """Read the corners of a mesh, if there is one left."""
        if not read.unread_meshes:
            return False
        if (mesh := read.unread_meshes.pop()) in self._store:
            self._store.corners(mesh)
        return True

    def ask(self, request: ParseRequest, on_read: Callable[[ParseResult], None]) -> None:
        """See `DescriptionProvider`."""
        number, self._next_number = self._next_number, self._next_number + 1
        self._asked[number] = on_read
        self._reader.submit(msgspec.structs.replace(request, number=number))

    def _is_usable(self, reading: ParseKey) -> bool:
        """Whether something is read, and the meshes of it are still here; else forget it."""
        found = self._read.get(reading)
        if isinstance(found, CachedModel) and not all(mesh in self._store for mesh in found.meshes):
            del self._read[reading]
        return reading in self._read

    def _submit(self, reading: ParseKey) -> None:
        try:
            files = self._files(reading.assets)
        except ModelError as error:
            self._keep(reading, error)
            return
        number, self._next_number = self._next_number, self._next_number + 1
        self._pending_keys[number] = reading
        self._numbers[reading] = number
        self._reader.submit(ParseRequest(number, *reading, files=files))

    def _files(self, assets: tuple[AssetRef, ...]) -> tuple[str, ...]:
        names = tuple(dict.fromkeys(ref.sha256 for ref in assets))
        total = sum(self._store.size(name) for name in names)
        if len(assets) > MAX_BUNDLE_FILES or total > MAX_BUNDLE_BYTES:
            raise ModelError(
                f"{len(assets)} files of {total} bytes in all; at most {MAX_BUNDLE_FILES} files "
                f"of {MAX_BUNDLE_BYTES} bytes are taken",
                slug="bundle.size",
            )
        return names

    def _note(self, answer: ParseResult) -> None:
        if (on_read := self._asked.pop(answer.number, None)) is not None:
            on_read(answer)
            return
        reading = self._pending_keys.pop(answer.number)
        del self._numbers[reading]
        if answer.model is not None:
            self._keep(reading, self._make_parsed_model(answer.model))
        else:
            self._keep(reading, ModelError(answer.message, code=answer.code, slug=answer.slug))
        if answer.slug in TRANSIENT_SLUGS:
            self._transient.append(reading)

    def _make_parsed_model(self, model: Model) -> CachedModel:
        colliding = _list_collision_meshes(model)
        is_small = len(colliding) <= MAX_MESHES_AT_ONCE and not (model.is_static and colliding)
        read = CachedModel(model, list_meshes(model), is_prepared=is_small)
        if not is_small:
            read.unread_meshes.extend(set(colliding))
            self._unprepared.append(read)
        return read

    def _keep(self, reading: ParseKey, found: CachedModel | ModelError) -> None:
        self._read[reading] = found
        while len(self._read) > MAX_CACHED_MODELS or self._characters() > MAX_CACHED_CHARACTERS:
            self._read.popitem(last=False)

    def _characters(self) -> int:
        return sum(len(reading.text) for reading in self._read)

    def _reading_of(self, order: SpawnEntityOrder) -> ParseKey:
        # Files that are not here are no part of it: once they come it is another reading.
        present = tuple(ref for ref in order.assets if ref.sha256 in self._store)
        text = resolve_resource(order.entity_resource)
        return ParseKey(text, order.compat, order.allow_missing, present, order.dynamics)


def list_meshes(model: Model) -> frozenset[str]:
    """List the sha256 of all meshes that a model names."""
    shapes = (shape for link in model.links for shape in (*link.collisions, *link.visuals))
    return frozenset(shape.mesh for shape in shapes if shape.mesh)


def _list_collision_meshes(model: Model) -> list[str]:
    """List the mesh of each collision: an engine makes a hull for every one of them anew."""
    return [shape.mesh for link in model.links for shape in link.collisions if shape.mesh]
