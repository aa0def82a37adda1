"""Models of the texts that spawns bring: read by the reader process, each once, kept for others."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple, Protocol

import msgspec

from zensim.proto.messages.asset_messages import MAX_BUNDLE_BYTES, MAX_BUNDLE_FILES, AssetRef
from zensim.sim_server.description.builtin_models import resolve_resource
from zensim.sim_server.errors import ModelError
from zensim.sim_server.reading.messages import MeshMade, ReadRequest, TextRead

if TYPE_CHECKING:
    from collections.abc import Callable

    from zensim.proto.messages.model_messages import Dynamics, Model
    from zensim.proto.messages.spawn_messages import Compat, SpawnEntityOrder
    from zensim.sim_server.reading.assets import AssetStore
    from zensim.sim_server.reading.reader import Reader

KEPT = 512
KEPT_CHARACTERS = 64 << 20
FEW_MESHES = 16
"""Collisions: so many hulls are made in a moment, be they of one mesh or of many."""
RESTS = 2
TRANSIENT = frozenset({"reader.crashed", "reader.timeout"})
"""Faults that another try may not have."""


class Reading(NamedTuple):
    """What is read: the same reading gives the same model."""

    text: str
    compat: Compat
    allow_missing: bool
    assets: tuple[AssetRef, ...]
    dynamics: Dynamics = ""


@dataclass
class Read:
    """A model, and the files that it names by sha256."""

    model: Model
    meshes: frozenset[str]
    is_prepared: bool
    """Whether the engine can take it between two steps."""
    unseen: list[str] = field(default_factory=list)
    """Meshes whose corners have to be read before; a spawn asks for them."""


class Descriptions(Protocol):
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

    def reading_of(self, model: Model) -> Reading | None:
        """Find what a model was read from, if that is still known."""

    def remember(self, reading: Reading, model: Model) -> None:
        """Take over what another server has read."""

    def ask(self, request: ReadRequest, on_read: Callable[[TextRead], None]) -> None:
        """Have a text read besides; `poll` calls with the answer, once what it names is kept.

        Args:
            request: What to read; its number is chosen here.
            on_read: Told once.
        """


class ReadElsewhere:
    """Descriptions that the reader process reads."""

    def __init__(
        self,
        reader: Reader,
        store: AssetStore,
        prepare: Callable[[Model], bool],
        now_ns: Callable[[], int],
    ) -> None:
        self._reader = reader
        self._store = store
        self._prepare = prepare
        self._now_ns = now_ns
        self._rest_until_ns = 0
        self._unprepared: list[Read] = []
        self._read: OrderedDict[Reading, Read | ModelError] = OrderedDict()
        self._under_way: dict[int, Reading] = {}
        self._numbers: dict[Reading, int] = {}
        self._transient: list[Reading] = []
        self._asked: dict[int, Callable[[TextRead], None]] = {}
        self._next_number = 1

    def is_read(self, order: SpawnEntityOrder) -> bool:
        """See `Descriptions`."""
        try:
            reading = self._reading_of(order)
        except ModelError:
            return True
        if not self._is_usable(reading) and reading not in self._numbers:
            self._submit(reading)
        found = self._read.get(reading)
        return found.is_prepared if isinstance(found, Read) else found is not None

    def model(self, order: SpawnEntityOrder) -> tuple[Model, str]:
        """See `Descriptions`."""
        reading = self._reading_of(order)
        found = self._read[reading]
        if isinstance(found, ModelError):
            raise found
        self._read.move_to_end(reading)
        for mesh in found.meshes:
            self._store.size(mesh)  # so that it is not the first to go
        return found.model, reading.text

    def poll(self) -> bool:
        """See `Descriptions`."""
        # Whoever waited for it has been told by now.
        for reading in self._transient:
            self._read.pop(reading, None)
        self._transient.clear()
        messages = self._reader.poll()
        for message in messages:
            if isinstance(message, MeshMade):
                self._store.keep(message.sha256, message.data)
            else:
                self._note(message)
        return self._has_prepared() or bool(messages)

    def reading_of(self, model: Model) -> Reading | None:
        """See `Descriptions`."""
        for reading, found in reversed(self._read.items()):
            if isinstance(found, Read) and found.model is model:
                return reading
        return None

    def remember(self, reading: Reading, model: Model) -> None:
        """See `Descriptions`."""
        if reading not in self._read:
            self._keep(reading, self._as_read(model))

    def _has_prepared(self) -> bool:
        """Prepare a part of a large model, and rest for twice as long: steps come first."""
        if not self._unprepared or (start_ns := self._now_ns()) < self._rest_until_ns:
            return False
        read = self._unprepared[0]
        read.is_prepared = not self._sees_corners(read) and self._prepare(read.model)
        end_ns = self._now_ns()
        self._rest_until_ns = end_ns + RESTS * (end_ns - start_ns)
        if read.is_prepared:
            self._unprepared.pop(0)
        return read.is_prepared

    def _sees_corners(self, read: Read) -> bool:
        """Read the corners of a mesh, if there is one left."""
        if not read.unseen:
            return False
        if (mesh := read.unseen.pop()) in self._store:
            self._store.corners(mesh)
        return True

    def ask(self, request: ReadRequest, on_read: Callable[[TextRead], None]) -> None:
        """See `Descriptions`."""
        number, self._next_number = self._next_number, self._next_number + 1
        self._asked[number] = on_read
        self._reader.submit(msgspec.structs.replace(request, number=number))

    def _is_usable(self, reading: Reading) -> bool:
        """Whether something is read, and the meshes of it are still here; else forget it."""
        found = self._read.get(reading)
        if isinstance(found, Read) and not all(mesh in self._store for mesh in found.meshes):
            del self._read[reading]
        return reading in self._read

    def _submit(self, reading: Reading) -> None:
        try:
            files = self._files(reading.assets)
        except ModelError as error:
            self._keep(reading, error)
            return
        number, self._next_number = self._next_number, self._next_number + 1
        self._under_way[number] = reading
        self._numbers[reading] = number
        self._reader.submit(ReadRequest(number, *reading, files=files))

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

    def _note(self, answer: TextRead) -> None:
        if (on_read := self._asked.pop(answer.number, None)) is not None:
            on_read(answer)
            return
        reading = self._under_way.pop(answer.number)
        del self._numbers[reading]
        if answer.model is not None:
            self._keep(reading, self._as_read(answer.model))
        else:
            self._keep(reading, ModelError(answer.message, code=answer.code, slug=answer.slug))
        if answer.slug in TRANSIENT:
            self._transient.append(reading)

    def _as_read(self, model: Model) -> Read:
        colliding = _colliding(model)
        is_small = len(colliding) <= FEW_MESHES and not (model.is_static and colliding)
        read = Read(model, meshes_of(model), is_prepared=is_small)
        if not is_small:
            read.unseen.extend(set(colliding))
            self._unprepared.append(read)
        return read

    def _keep(self, reading: Reading, found: Read | ModelError) -> None:
        self._read[reading] = found
        while len(self._read) > KEPT or self._characters() > KEPT_CHARACTERS:
            self._read.popitem(last=False)

    def _characters(self) -> int:
        return sum(len(reading.text) for reading in self._read)

    def _reading_of(self, order: SpawnEntityOrder) -> Reading:
        # Files that are not here are no part of it: once they come it is another reading.
        present = tuple(ref for ref in order.assets if ref.sha256 in self._store)
        text = resolve_resource(order.entity_resource)
        return Reading(text, order.compat, order.allow_missing, present, order.dynamics)


def meshes_of(model: Model) -> frozenset[str]:
    """List the sha256 of all meshes that a model names."""
    shapes = (shape for link in model.links for shape in (*link.collisions, *link.visuals))
    return frozenset(shape.mesh for shape in shapes if shape.mesh)


def _colliding(model: Model) -> list[str]:
    """List the mesh of each collision: an engine makes a hull for every one of them anew."""
    return [shape.mesh for link in model.links for shape in link.collisions if shape.mesh]
