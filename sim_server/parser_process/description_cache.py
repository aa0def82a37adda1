"""Models parsed from spawn requests, each parsed once by the parser process and cached."""

from __future__ import annotations

from collections import OrderedDict
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple, Protocol

import msgspec

from zensim.proto.messages.asset_messages import MAX_BUNDLE_BYTES, MAX_BUNDLE_FILES, AssetRef
from zensim.proto.messages.drive_messages import DriveOrder
from zensim.sim_server.description.builtin_models import resolve_resource
from zensim.sim_server.errors import AssetRefused, ModelError
from zensim.sim_server.parser_process.parser_protocol import ParsedMesh, ParseRequest, ParseResult

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from zensim.proto.messages.model_messages import Dynamics, Model
    from zensim.proto.messages.spawn_messages import Compat, SpawnEntityOrder
    from zensim.sim_server.parser_process.asset_store import AssetStore

MAX_CACHED_MODELS = 512
MAX_CACHED_CHARACTERS = 64 << 20
MAX_MESHES_AT_ONCE = 16
"""Collision meshes whose hulls can be made between two steps."""
REST_RATIO = 2
"""Pause after a part of a preparation, as a multiple of its duration."""
TRANSIENT_SLUGS = frozenset({"reader.busy", "reader.crashed", "reader.timeout", "bundle.disk"})
"""Errors that a retry may avoid: they are not cached."""


class ParseKey(NamedTuple):
    """Everything that the parsed model depends on."""

    text: str
    compat: Compat
    allow_missing: bool
    assets: tuple[AssetRef, ...]
    dynamics: Dynamics = ""
    controllers: tuple[str, ...] = ()
    drive: DriveOrder = DriveOrder()


@dataclass
class CachedModel:
    """A model, and the sha256 of its meshes and textures."""

    model: Model
    assets: frozenset[str]
    is_prepared: bool
    """Whether the engine can add it between two steps."""
    unread_meshes: list[str] = field(default_factory=list)
    """Meshes whose vertices must be read first, because a spawn needs them."""


class DescriptionProvider(Protocol):
    """Parses the descriptions of spawn requests."""

    def is_parsed(self, order: SpawnEntityOrder) -> bool:
        """Whether `model` has a result now; if not, parsing has been started."""

    def model(self, order: SpawnEntityOrder) -> tuple[Model, str]:
        """Return the model and its text.

        Raises:
            ModelError: The description cannot be used.
        """

    def poll(self) -> bool:
        """Process results of the parser; return whether there were any."""

    def find_parse_key(self, model: Model) -> ParseKey | None:
        """Find the key of a cached model; None if it is not cached any more."""

    def remember(self, key: ParseKey, model: Model) -> None:
        """Add a model that another server has parsed."""

    def parse(self, request: ParseRequest, on_parsed: Callable[[ParseResult], None]) -> None:
        """Parse a text that is not cached.

        Args:
            request: Its number is replaced.
            on_parsed: Called once by `poll`, after the meshes have been stored.
        """


class Parser(Protocol):
    """Parses texts, in another process or in this one."""

    def submit(self, request: ParseRequest) -> None:
        """Start to parse a text."""

    def poll(self) -> Sequence[ParsedMesh | ParseResult]:
        """Take the messages of finished requests."""


class DescriptionCache:
    """Descriptions parsed by the parser process."""

    def __init__(
        self,
        parser: Parser,
        store: AssetStore,
        prepare: Callable[[Model], bool],
        now_ns: Callable[[], int],
    ) -> None:
        self._parser = parser
        self._store = store
        self._prepare = prepare
        self._now_ns = now_ns
        self._paused_until_ns = 0
        self._unprepared: list[CachedModel] = []
        self._results: OrderedDict[ParseKey, CachedModel | ModelError] = OrderedDict()
        self._characters = 0
        """Characters of the texts of all results."""
        self._pending_keys: dict[int, ParseKey] = {}
        self._numbers: dict[ParseKey, int] = {}
        self._transient: list[ParseKey] = []
        self._callbacks: dict[int, Callable[[ParseResult], None]] = {}
        self._next_number = 1
        self._unstored: AssetRefused | None = None
        """Why a mesh of the next result is missing."""

    def is_parsed(self, order: SpawnEntityOrder) -> bool:
        """See `DescriptionProvider`."""
        try:
            key = self._make_key(order)
        except ModelError:
            return True
        if not self._is_usable(key) and key not in self._numbers:
            self._submit(key)
        found = self._results.get(key)
        return found.is_prepared if isinstance(found, CachedModel) else found is not None

    def model(self, order: SpawnEntityOrder) -> tuple[Model, str]:
        """See `DescriptionProvider`."""
        key = self._make_key(order)
        found = self._results[key]
        if isinstance(found, ModelError):
            raise found
        self._results.move_to_end(key)
        for name in found.assets:
            self._store.size(name)  # marks it as used
        return found.model, key.text

    def poll(self) -> bool:
        """See `DescriptionProvider`."""
        # The requests that waited for them have been answered.
        for key in self._transient:
            self._forget(key)
        self._transient.clear()
        messages = self._parser.poll()
        for message in messages:
            if isinstance(message, ParsedMesh):
                self._add_mesh(message)
            else:
                self._store_result(message)
        return self._prepare_next() or bool(messages)

    def find_parse_key(self, model: Model) -> ParseKey | None:
        """See `DescriptionProvider`."""
        for key, found in reversed(self._results.items()):
            if isinstance(found, CachedModel) and found.model is model:
                return key
        return None

    def _add_mesh(self, mesh: ParsedMesh) -> None:
        try:
            self._store.add(mesh.sha256, mesh.data)
        except AssetRefused as error:
            self._unstored = error

    def remember(self, key: ParseKey, model: Model) -> None:
        """See `DescriptionProvider`."""
        if key not in self._results:
            self._cache(key, self._make_parsed_model(model))

    def _prepare_next(self) -> bool:
        """Prepare a part of a large model, then pause for twice as long: steps come first."""
        if not self._unprepared or (start_ns := self._now_ns()) < self._paused_until_ns:
            return False
        cached = self._unprepared[0]
        cached.is_prepared = not self._read_next_vertices(cached) and self._prepare(cached.model)
        end_ns = self._now_ns()
        self._paused_until_ns = end_ns + REST_RATIO * (end_ns - start_ns)
        if cached.is_prepared:
            self._unprepared.pop(0)
        return cached.is_prepared

    def _read_next_vertices(self, cached: CachedModel) -> bool:
        """Read the vertices of the next mesh, if one is left."""
        if not cached.unread_meshes:
            return False
        if (mesh := cached.unread_meshes.pop()) in self._store:
            with suppress(AssetRefused, ValueError):  # the spawn is refused for it
                self._store.vertices(mesh)
        return True

    def parse(self, request: ParseRequest, on_parsed: Callable[[ParseResult], None]) -> None:
        """See `DescriptionProvider`."""
        number, self._next_number = self._next_number, self._next_number + 1
        self._callbacks[number] = on_parsed
        self._parser.submit(msgspec.structs.replace(request, number=number))

    def _is_usable(self, key: ParseKey) -> bool:
        """Whether it is cached with all its assets; drop it if one was evicted."""
        found = self._results.get(key)
        if isinstance(found, CachedModel) and not all(name in self._store for name in found.assets):
            self._forget(key)
        return key in self._results

    def _submit(self, key: ParseKey) -> None:
        try:
            files = self._list_files(key.assets)
        except ModelError as error:
            self._cache(key, error)
            return
        number, self._next_number = self._next_number, self._next_number + 1
        self._pending_keys[number] = key
        self._numbers[key] = number
        self._parser.submit(ParseRequest(number, *key, files=files))

    def _list_files(self, assets: tuple[AssetRef, ...]) -> tuple[str, ...]:
        names = tuple(dict.fromkeys(ref.sha256 for ref in assets))
        total = sum(self._store.size(name) for name in names)
        if len(assets) > MAX_BUNDLE_FILES or total > MAX_BUNDLE_BYTES:
            raise ModelError(
                f"{len(assets)} files of {total} bytes in total; use at most {MAX_BUNDLE_FILES} "
                f"files of {MAX_BUNDLE_BYTES} bytes",
                slug="bundle.size",
            )
        return names

    def _store_result(self, result: ParseResult) -> None:
        if (unstored := self._unstored) is not None:
            # The meshes of a result precede it.
            self._unstored = None
            result = ParseResult(
                result.number, None, code=unstored.code, message=unstored.fault, slug=unstored.slug
            )
        if (on_parsed := self._callbacks.pop(result.number, None)) is not None:
            on_parsed(result)
            return
        key = self._pending_keys.pop(result.number)
        del self._numbers[key]
        if result.model is not None:
            self._cache(key, self._make_parsed_model(result.model))
        else:
            self._cache(key, ModelError(result.message, code=result.code, slug=result.slug))
        if result.slug in TRANSIENT_SLUGS:
            self._transient.append(key)

    def _make_parsed_model(self, model: Model) -> CachedModel:
        colliding = list_collision_meshes(model)
        is_small = len(colliding) <= MAX_MESHES_AT_ONCE and not (model.is_static and colliding)
        cached = CachedModel(model, list_assets(model), is_prepared=is_small)
        if not is_small:
            cached.unread_meshes.extend(set(colliding))
            self._unprepared.append(cached)
        return cached

    def _cache(self, key: ParseKey, found: CachedModel | ModelError) -> None:
        self._forget(key)
        self._results[key] = found
        self._characters += _count_characters(key)
        while len(self._results) > MAX_CACHED_MODELS or self._characters > MAX_CACHED_CHARACTERS:
            self._forget(next(iter(self._results)))

    def _forget(self, key: ParseKey) -> None:
        if self._results.pop(key, None) is not None:
            self._characters -= _count_characters(key)

    def _make_key(self, order: SpawnEntityOrder) -> ParseKey:
        # Missing files are left out: when they arrive the key is another.
        present = tuple(ref for ref in order.assets if ref.sha256 in self._store)
        text = resolve_resource(order.entity_resource)
        return ParseKey(
            text,
            order.compat,
            order.allow_missing,
            present,
            order.dynamics,
            order.controllers,
            order.drive,
        )


def _count_characters(key: ParseKey) -> int:
    return len(key.text) + sum(map(len, key.controllers))


def list_assets(model: Model) -> frozenset[str]:
    """List the sha256 of all meshes, images and texture coordinates of a model."""
    shapes = [shape for link in model.links for shape in (*link.collisions, *link.visuals)]
    textures = (shape.texture for shape in shapes if shape.texture is not None)
    names = (name for texture in textures for name in (texture.image, texture.coordinates))
    return frozenset(name for name in (*(shape.mesh for shape in shapes), *names) if name)


def list_collision_meshes(model: Model) -> list[str]:
    """List the mesh of each collision shape: an engine makes a hull for each of them."""
    return [shape.mesh for link in model.links for shape in link.collisions if shape.mesh]
