"""Records of an input log: where it begins, the calls of the engine, and hashes of states."""

import platform
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

import msgspec
import numpy as np
import numpy.typing as npt

from zensim.proto.engine_proofs import EngineName
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.package_versions import find_package_version
from zensim.proto.settings.engine_settings import EngineSettings
from zensim.sim_server.physics.engine import BodyStates, Engine, IntArray
from zensim.sim_server.physics.engine_calls import MAX_STEPS, AnyCall
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.engine_factory import MAX_PARALLEL_CELLS
from zensim.sim_server.world_loading.world_loader import make_layered_engine

FORMAT = 2
"""Number of the records; a reader refuses others."""
MAX_MESSAGE_BYTES = 1 << 20
"""Bytes of the records of a message; one record may be longer."""
CPU_FILE = Path("/proc/cpuinfo")
CPU_FIELDS = ("vendor_id", "cpu family", "CPU implementer", "CPU architecture")

Origin: TypeAlias = Literal["fresh", "bodies"]
"""Origin of the first state: an engine without bodies, or what bodies show of an engine's state."""
Sums: TypeAlias = npt.NDArray[np.uint32]


class HostVersions(msgspec.Struct, frozen=True):
    """What must be equal for equal bits."""

    zensim: str
    engine: str
    numpy: str
    cpu: str
    """Kind of processor, its maker and family."""


class EngineRecipe(msgspec.Struct, frozen=True):
    """How the engine of a world is made."""

    options: EngineSettings
    control_steps: Annotated[int, msgspec.Meta(ge=1, le=MAX_STEPS)]
    step_ns: Annotated[int, msgspec.Meta(ge=1_000, le=NANOSECONDS)]
    gravity: tuple[float, float, float]
    has_ground: bool
    ground_friction: float

    def make(self, mesh_folder: str) -> Engine:
        """Make the engine; its meshes are in a folder.

        Raises:
            EngineMissing: Its library is not installed.
        """
        options = self.options.limit_workers(MAX_PARALLEL_CELLS)
        config = EngineConfig(
            self.step_ns,
            self.gravity,
            self.has_ground,
            self.ground_friction,
            mesh_folder,
            self.options.compiles_ahead,
        )
        return make_layered_engine(config, options, control_steps=self.control_steps)


class LogRecord(msgspec.Struct, frozen=True, array_like=True, tag=str.lower):
    """A record that is no call."""


class LogStart(LogRecord, frozen=True):
    """Where a run can begin; what follows up to the first call are the bodies of that moment."""

    format: int
    versions: HostVersions
    recipe: EngineRecipe
    origin: Origin
    world: str
    epoch: int
    step: int


class LogEnd(LogRecord, frozen=True):
    """The last record of a log that its server has ended."""


class StoredMesh(LogRecord, frozen=True):
    """A file of a model."""

    name: str
    data: bytes


class PresentBody(LogRecord, frozen=True):
    """A body at the start of a log that does not begin with an engine without bodies."""

    body: int
    model: int
    base: bytes
    positions: bytes
    velocities: bytes
    is_hidden: bool


class LoggedRoster(LogRecord, frozen=True):
    """The entities of the states that follow."""

    names: tuple[str, ...]
    bodies: tuple[int, ...]
    joint_counts: tuple[int, ...]
    frozen: tuple[int, ...]
    """Places of those whose joints the engine does not have any more."""


class StateSums(LogRecord, frozen=True):
    """A number for the state of each entity at a control step, (n,) uint32."""

    step: int
    sums: bytes


class RecordedState(LogRecord, frozen=True):
    """States of all entities, once in each simulated second."""

    epoch: int
    step: int
    time_ns: int
    digest: str
    """Digest that `state_hash()` of the Python API returns."""
    base: bytes
    """States of bases (n, 13)."""
    positions: bytes
    velocities: bytes


AnyRecord: TypeAlias = (
    LogStart
    | LogEnd
    | StoredMesh
    | PresentBody
    | LoggedRoster
    | StateSums
    | RecordedState
    | AnyCall
)
_ENCODER = msgspec.msgpack.Encoder()
_DECODER = msgspec.msgpack.Decoder(tuple[AnyRecord, ...])
ARRAY_32 = b"\xdd"
"""Mark in MessagePack of an array whose length has four bytes."""


def write_records(records: Iterable[AnyRecord]) -> Iterator[bytes]:
    """Encode records in parts of `MAX_MESSAGE_BYTES` at most, or of one record."""
    part: list[bytes] = []
    size = 0
    for record in records:
        data = _ENCODER.encode(record)
        if part and size + len(data) > MAX_MESSAGE_BYTES:
            yield _join(part)
            part, size = [], 0
        part.append(data)
        size += len(data)
    if part:
        yield _join(part)


def _join(part: Sequence[bytes]) -> bytes:
    return b"".join((ARRAY_32, len(part).to_bytes(4, "big"), *part))


def read_records(data: bytes) -> tuple[AnyRecord, ...]:
    """Read what `write_records` wrote.

    Raises:
        msgspec.DecodeError: The bytes are no records.
    """
    return _DECODER.decode(data)


def find_versions(engine: EngineName) -> HostVersions:
    """Find what this host has."""
    return HostVersions(
        version("zensim"), f"{engine} {find_package_version(engine)}", np.__version__, find_cpu()
    )


@cache
def find_cpu() -> str:
    """Name the kind of processor, its maker and family."""
    try:
        lines = CPU_FILE.read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        lines = []
    pairs = [(name.strip(), value.strip()) for name, _, value in (x.partition(":") for x in lines)]
    found = dict(reversed(pairs))
    return " ".join([platform.machine(), *(found[name] for name in CPU_FIELDS if name in found)])


class StateSummer:
    """Makes a number for the state of each entity, so that one bit more or less changes it."""

    def __init__(self, joint_counts: IntArray, frozen: Sequence[int] = ()) -> None:
        """Prepare for entities with these numbers of joints.

        Args:
            joint_counts: (n,).
            frozen: Places of entities whose joints are left out.
        """
        ends = np.cumsum(joint_counts)
        self._starts, self._ends = ends - joint_counts, ends
        place = np.arange(joint_counts.sum()) - np.repeat(self._starts, joint_counts)
        owners = np.repeat(np.arange(len(joint_counts)), joint_counts)
        is_used = ~np.isin(owners, np.array(frozen, dtype=np.intp))
        self._of_base = _make_weights(np.arange(13))
        self._of_positions = _make_weights(13 + 2 * place) * is_used
        self._of_velocities = _make_weights(14 + 2 * place) * is_used

    def sum(self, states: BodyStates) -> Sums:
        """Make the numbers (n,)."""
        sums = (_bits_of(states.base) * self._of_base).sum(axis=1, dtype=np.uint64)
        if len(self._of_positions):
            terms = _bits_of(states.joint_positions) * self._of_positions
            terms += _bits_of(states.joint_velocities) * self._of_velocities
            totals = np.concatenate([np.zeros(1, np.uint64), np.cumsum(terms, dtype=np.uint64)])
            sums += totals[self._ends] - totals[self._starts]
        # The upper half depends on all bits, as the weights are odd and random.
        return np.asarray(sums >> np.uint64(32), dtype=np.uint32)


def _bits_of(values: npt.NDArray[np.float64]) -> npt.NDArray[np.uint64]:
    return np.ascontiguousarray(values).view(np.uint64)


def _make_weights(places: IntArray) -> npt.NDArray[np.uint64]:
    """Make an odd number for each place, as SplitMix64 mixes its count."""
    mixed = (places.astype(np.uint64) + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray((mixed ^ (mixed >> np.uint64(31))) | np.uint64(1))
