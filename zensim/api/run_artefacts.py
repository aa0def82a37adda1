"""What a failed test leaves behind: a report of the simulation, and its last events."""

from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from zensim.api.api_errors import Error
from zensim.api.simulation import Simulation
from zensim.proto.messages.telemetry_messages import Event

if TYPE_CHECKING:
    from zensim.api.topic import Topic


class RobotReport(msgspec.Struct, frozen=True):
    """An entity at the end of a test."""

    name: str
    pose: tuple[float, ...]
    """x y z [m], qx qy qz qw."""
    twist: tuple[float, ...]
    """In its own frame [m/s], [rad/s]."""


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


class RunArtefacts:
    """Follows the events of a simulation, and writes files when its test has failed."""

    def __init__(self, sim: Simulation) -> None:
        self._sim = sim
        self._events: Topic[Event] = sim.topic(f"sim/{sim.info.world}/events", Event)
        self._events.collect()

    def write(self, folder: Path, *, test: str, message: str) -> tuple[Path, ...]:
        """Write `report.json` and `events.jsonl`; return their paths."""
        folder.mkdir(parents=True, exist_ok=True)
        report, events = folder / "report.json", folder / "events.jsonl"
        report.write_bytes(
            msgspec.json.format(msgspec.json.encode(self._make_report(test, message)), indent=1)
        )
        lines = [msgspec.json.encode(one) + b"\n" for one in self._take_events()]
        events.write_bytes(b"".join(lines))
        return report, events

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

    def _take_events(self) -> list[Event]:
        found: list[Event] = []
        try:
            while True:
                found.append(self._events.read(timeout_s=0.0))
        except Error:
            return found
