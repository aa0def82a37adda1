"""Fuzzer of a real server: damaged robots beside one that must not notice them.

`python -m tests.hostile.server_fuzz [--runs N] [--engine NAME] [--keep FOLDER] [FOLDER]` spawns
mutants of the robots of this repository, and of all descriptions in FOLDER, in a world in lockstep.
The server must survive each, and the states of a driven robot must equal those of a run without.
"""

import argparse
import random
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from pathlib import Path

import msgspec

from tests.hostile.fuzz import make_mesh
from tests.hostile.mutants import MESH_URI, mutate, own_robots
from tests.integration.processes import (
    START_S,
    Server,
    eventually,
    running,
    serving,
    wait_for_agents,
)
from tests.integration.repeatable_run import LOCKSTEP
from tests.integration.robots import robot
from zensim.proto.bus.bus_errors import BusError
from zensim.proto.codec.message_codec import MalformedPayload, decode
from zensim.proto.messages.asset_messages import AssetRef
from zensim.proto.messages.entity_messages import BoundsType
from zensim.proto.messages.result_messages import ResultCode, ServiceError
from zensim.proto.messages.spawn_messages import (
    Resource,
    SpawnEntitiesOrder,
    SpawnEntity,
    SpawnEntityOrder,
)
from zensim.proto.messages.standard_messages import Point, Pose, PoseStamped
from zensim.proto.messages.telemetry_messages import Event, Snapshot
from zensim.proto.topic_catalog import EVENTS, ODOM
from zensim.spawner.spawn.description_sources import read_model_argument
from zensim.spawner.spawn.description_xml import DescriptionError
from zensim.spawner.spawn.search_paths import collect_search_paths

RUNS = 10_000
ENGINES = ("pybullet", "mujoco")
STEPS = 10
"""Steps for which a mutant lives."""
MAX_TEXT = 200_000
"""Longest description that is mutated."""
BASE_BYTES = 13 * 8
DRY_RUNS, BATCHES, SNAPPED = 0.2, 0.1, 0.5
"""Shares of the mutants."""
OWN_MESH = AssetRef(MESH_URI, sha256(make_mesh("stl")).hexdigest())
BYSTANDER = "bystander"
MUTANT = "mutant"
SNAPSHOT_KEY = "sim/default/snapshot"
MUTANT_AT = Point(20_000.0, 5_000.0, 1.0)
SAFE_M = 10_000.0
"""A mutant that reaches farther is not stepped: it may touch the other robot."""
SUFFIXES = (".urdf", ".sdf", ".xacro")
LOST = (BusError, TimeoutError, MalformedPayload)
"""What a client gets from a server that has ended or hangs."""


@dataclass(frozen=True)
class Seed:
    """A description, and the files that it names."""

    text: str
    assets: tuple[AssetRef, ...] = ()


class FuzzFailure(Exception):
    """A mutant that ended the server, or changed the other robot."""


@dataclass(frozen=True)
class FuzzSettings:
    """What is fuzzed.

    Attributes:
        engine: Name of the engine.
        runs: Number of mutants.
        log: File for the output of the server.
        options: Further options of `zensim serve`.
    """

    engine: str
    runs: int
    log: Path
    seed: int = 0
    options: tuple[str, ...] = ()


class FuzzedServer:
    """A server in lockstep with a driven robot."""

    def __init__(self, server: Server) -> None:
        self._server = server
        self._events = server.bus.subscribe(EVENTS.key("default"), 10_000)
        self._joints = len(self._snapshot().joint_positions)
        robot(server.bus, BYSTANDER).command(0.3, 0.8)

    def advance(self) -> bytes:
        """Make some steps; return a hash of the driven robot's state."""
        self._server.client.simulate_steps(STEPS)
        now = self._snapshot()
        return sha256(now.base[:BASE_BYTES] + now.joint_positions[: self._joints]).digest()

    def try_mutant(self, order: SpawnEntityOrder, chance: random.Random) -> tuple[str, bytes]:
        """Spawn a mutant, make some steps, and delete it.

        Returns:
            The outcome, and the hash of the driven robot's state.
        """
        try:
            self._spawn(order, chance)
        except ServiceError as refusal:
            return find_slug(refusal.message), self.advance()
        if not self._is_safe():
            self._server.client.delete(MUTANT)
            return "too large", self.advance()
        digest = self.advance()
        self._server.client.delete(MUTANT)
        return "frozen" if self._has_frozen() else "simulated", digest

    def _spawn(self, order: SpawnEntityOrder, chance: random.Random) -> None:
        """Spawn alone or in a batch, perhaps after a dry run."""
        client = self._server.client
        if chance.random() < DRY_RUNS:
            client.spawn(msgspec.structs.replace(order, dry_run=True))
        if chance.random() < BATCHES:
            one = SpawnEntity(order.name, initial_pose=order.initial_pose)
            atomic = SpawnEntitiesOrder(spawn_requests=(one,), atomic=True, common=order)
            (result,) = client.spawn_all(atomic).results
            if result.result.result != ResultCode.OK:
                raise ServiceError("", result.result.result, "", result.result.error_message)
        else:
            client.spawn(order)

    def _is_safe(self) -> bool:
        """Whether the mutant is too small to touch the other robot."""
        bounds = self._server.client.entity_bounds(MUTANT, BoundsType.SPHERE)
        return len(bounds.points) == 2 and bounds.points[1].x < SAFE_M

    def _has_frozen(self) -> bool:
        received = [decode(Event, one.payload, one.encoding) for one in self._events.take()]
        return any(one.kind == "warning" and "frozen" in one.message for one in received)

    def _snapshot(self) -> Snapshot:
        # A busy host may be late, or lose the link for a moment.
        get = partial(self._server.bus.get, SNAPSHOT_KEY)
        (sample,) = eventually(lambda: get() or None, START_S, "a snapshot")
        return decode(Snapshot, sample.payload, sample.encoding)


def find_slug(message: str) -> str:
    """Find the slug that a refusal begins with."""
    slug, separator, _ = message.partition(": ")
    return slug if separator and " " not in slug else "refused"


@contextmanager
def serving_bystander(settings: FuzzSettings) -> Iterator[FuzzedServer]:
    """Run a paused world with a driven robot; output goes to the log: nobody reads a pipe."""
    redirected = ("sh", "-c", 'log=$1; shift; exec "$@" >>"$log" 2>&1', "sh", str(settings.log))
    options = (*LOCKSTEP, "--engine", settings.engine, *settings.options)
    with serving(*options, prefix=redirected) as server:
        order = SpawnEntityOrder(
            BYSTANDER, entity_resource=Resource(uri="box_bot"), snap_to_ground=True
        )
        server.client.spawn(order)
        mesh = make_mesh("stl")
        server.client.put_asset(OWN_MESH.sha256, offset=0, total=len(mesh), data=mesh)
        joining = ("--connect", server.endpoint, "--quiet", "--cmd-vel-timeout", "0")
        with running("agent", BYSTANDER, *joining):
            wait_for_agents(server, [BYSTANDER])
            # An agent that replies has published the initial pose, and receives commands.
            eventually(lambda: len(server.bus.get(ODOM.key(BYSTANDER))) == 1, START_S, "odometry")
            yield FuzzedServer(server)


def make_reference(settings: FuzzSettings) -> list[bytes]:
    """Make the hashes of the driven robot's states without mutants."""
    with serving_bystander(settings) as server:
        return [server.advance() for _ in range(settings.runs)]


def make_order(seed: Seed, chance: random.Random) -> SpawnEntityOrder:
    """Make the request to spawn a mutant."""
    return SpawnEntityOrder(
        MUTANT,
        entity_resource=Resource(resource_string=mutate(seed.text, chance)),
        assets=seed.assets,
        initial_pose=PoseStamped(pose=Pose(MUTANT_AT)),
        snap_to_ground=chance.random() < SNAPPED,
        allow_missing=True,
        dynamics=chance.choice(("", "", "", "auto", "kinematic")),
    )


def fuzz_server(
    settings: FuzzSettings, seeds: Sequence[Seed], reference: Sequence[bytes], first: int = 0
) -> Iterator[tuple[str, str]]:
    """Try mutants in one server.

    Args:
        settings: Of the run.
        seeds: Descriptions that are mutated.
        reference: Hashes of the driven robot's states.
        first: Number of the first mutant.

    Yields:
        The outcome of each mutant, and its text.

    Raises:
        FuzzFailure: The server ended or hangs, or the driven robot was disturbed.
    """
    with serving_bystander(settings) as server:
        for run, expected in zip(range(first, settings.runs), reference, strict=False):
            chance = random.Random(f"{settings.seed} {run}")
            order = make_order(chance.choice(seeds), chance)
            text = order.entity_resource.resource_string
            try:
                outcome, found = server.try_mutant(order, chance)
            except (*LOST, ServiceError) as error:
                raise FuzzFailure(f"run {run}: {error!r}", text) from error
            if found != expected:
                raise FuzzFailure(f"run {run}: the driven robot was disturbed", text)
            yield outcome, text


def own_seeds() -> list[Seed]:
    """Make the descriptions of this repository."""
    return [Seed(text, (OWN_MESH,)) for text in own_robots()]


def read_seeds(folder: Path) -> Iterator[Seed]:
    """Read the descriptions of a folder that can be expanded and are not too long; meshes are
    left out.
    """
    paths = collect_search_paths((folder,), {})
    for file in sorted(one for one in folder.rglob("*") if one.suffix in SUFFIXES):
        try:
            text = read_model_argument(str(file), {}, paths).text
        except (OSError, ValueError, DescriptionError):
            continue
        if len(text) <= MAX_TEXT and "<world" not in text:
            yield Seed(text)


def run_all(settings: FuzzSettings, seeds: Sequence[Seed], keep: Path | None) -> int:
    """Try all mutants, with a new server after each failure; print the counts.

    Returns:
        Number of failures.
    """
    began = time.perf_counter()
    reference = make_reference(settings)
    found: Counter[str] = Counter()
    while (done := found.total()) < settings.runs:
        try:
            for outcome, _ in fuzz_server(settings, seeds, reference, done):
                found[outcome] += 1
        except FuzzFailure as failure:  # noqa: PERF203 - each has a server of its own
            found["FAILED"] += 1
            report_failure(settings, failure, keep)
    counts = ", ".join(f"{outcome} {count}" for outcome, count in found.most_common())
    took_s = time.perf_counter() - began
    print(f"{settings.engine}: {found.total()} mutants in {took_s:.0f} s: {counts}")  # noqa: T201
    return found["FAILED"]


def report_failure(settings: FuzzSettings, failure: FuzzFailure, keep: Path | None) -> None:
    """Print a failure, and write its mutant to a folder."""
    reason, text = failure.args
    print(f"{settings.engine}: {reason}", flush=True)  # noqa: T201
    if keep is not None:
        number = reason.split()[1].rstrip(":")
        (keep / f"{settings.engine}_{number}.xml").write_text(f"{text}\n", encoding="utf-8")


def main() -> None:
    """Fuzz a server with each engine; print outcomes; exit with 1 if anything failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path, help="further descriptions")
    parser.add_argument("--runs", type=int, default=RUNS)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--engine", choices=ENGINES, action="append")
    parser.add_argument("--keep", type=Path, help="folder for mutants that fail, and logs")
    given = parser.parse_args()
    seeds = own_seeds() + (list(read_seeds(given.folder)) if given.folder else [])
    failures = 0
    if given.keep is not None:
        given.keep.mkdir(parents=True, exist_ok=True)
    for engine in given.engine or ENGINES:
        log = (given.keep or Path()) / f"{engine}.log" if given.keep else Path("/dev/null")
        settings = FuzzSettings(engine, given.runs, log, given.seed)
        failures += run_all(settings, seeds, given.keep)
    raise SystemExit(failures > 0)


if __name__ == "__main__":
    main()
