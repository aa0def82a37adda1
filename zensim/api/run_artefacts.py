"""What a failed test leaves behind: a report of the simulation, and its last events."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from zensim.api.api_errors import Error
from zensim.api.simulation import Simulation
from zensim.api.world_access import Message
from zensim.proto.messages.agent_messages import STATE_COLUMNS
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.messages.telemetry_messages import Event, Snapshot
from zensim.proto.topic_catalog import EVENTS, SNAPSHOT
from zensim.sim_server.scene.camera_images import CamerasUnavailable

if TYPE_CHECKING:
    from zensim.api.topic import Topic


class RobotReport(msgspec.Struct, frozen=True):
    """An entity at the end of a test."""

    name: str
    pose: tuple[float, ...]
    """x y z [m], qx qy qz qw."""
    twist: tuple[float, ...]
    """Linear [m/s] and angular [rad/s] velocity in its own frame."""


class FailureReport(msgspec.Struct, frozen=True):
    """The simulation at the end of a test that failed."""

    test: str
    repeat: str
    """Command that repeats it."""
    message: str
    seed: int
    engine: str
    world: str
    time: float
    """Simulation time [s]."""
    state_hash: str
    entities: tuple[RobotReport, ...]


class StateRecord(msgspec.Struct, frozen=True):
    """The poses of all entities at one time."""

    time: float
    """Simulation time [s]."""
    step: int
    poses: dict[str, tuple[float, ...]]
    """x y z [m], qx qy qz qw."""


class RunArtefacts:
    """Follows events and states of a simulation, and writes files when its test has failed."""

    def __init__(self, sim: Simulation) -> None:
        self._sim = sim
        # Of its own: what a test reads of the topics of its simulation is not missing here.
        make = sim._session.make_topic  # noqa: SLF001
        self._events: Topic[Event] = make(EVENTS.key(sim.info.world), Event)
        self._states: Topic[Snapshot] = make(SNAPSHOT.key(sim.info.world), Snapshot)
        for topic in (self._events, self._states):
            topic.collect()

    def write(self, folder: Path, *, test: str, message: str) -> tuple[Path, ...]:
        """Write report.json, events.jsonl, states.jsonl and picture.png; return their paths.

        There is no picture where this host cannot render cameras.
        """
        folder.mkdir(parents=True, exist_ok=True)
        report, events = folder / "report.json", folder / "events.jsonl"
        states = folder / "states.jsonl"
        report.write_bytes(
            msgspec.json.format(msgspec.json.encode(self._make_report(test, message)), indent=1)
        )
        happened = _take_all(self._events)
        events.write_bytes(_encode_lines(happened))
        states.write_bytes(_encode_lines(map(make_state_record, _take_all(self._states))))
        return report, events, states, *self._write_picture(folder / "picture.png")

    def _write_picture(self, file: Path) -> tuple[Path, ...]:
        """Take a picture of the end of the test, if that is possible here."""
        try:
            # Its libraries take a while, and are missing without the server extra.
            from zensim.api.world_picture import take_picture  # noqa: PLC0415
        except ImportError:
            return ()
        try:
            picture = take_picture(self._sim._session.access)  # noqa: SLF001
        except (CamerasUnavailable, Error, ServiceError):
            return ()
        file.write_bytes(picture)
        return (file,)

    def close(self) -> None:
        """End the subscriptions."""
        self._events.close()
        self._states.close()

    def _make_report(self, test: str, message: str) -> FailureReport:
        sim = self._sim
        handles = sim.entities.values()
        return FailureReport(
            test,
            f"python -m pytest {test!r}",
            message,
            sim.seed,
            sim.info.engine,
            sim.info.world_model,
            sim.time,
            sim.state_hash(),
            tuple(RobotReport(one.name, one.pose, one.twist) for one in handles),
        )


def make_state_record(snapshot: Snapshot) -> StateRecord:
    """Make a line of the log of states."""
    base = np.frombuffer(snapshot.base, dtype="<f8").reshape(-1, STATE_COLUMNS)
    poses = dict(zip(snapshot.names, map(tuple, base[:, :7].tolist()), strict=True))
    return StateRecord(snapshot.time_ns / NANOSECONDS, snapshot.step, poses)


def _take_all(topic: "Topic[Message]") -> list[Message]:
    found: list[Message] = []
    try:
        while True:
            found.append(topic.read(timeout_s=0.0))
    except Error:
        return found


def _encode_lines(records: Iterable[msgspec.Struct]) -> bytes:
    return b"".join(msgspec.json.encode(one) + b"\n" for one in records)
