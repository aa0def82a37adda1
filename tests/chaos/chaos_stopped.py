"""A server that is suspended and resumed

The server, its own router, is suspended with SIGSTOP for 30 s. Measured is the time from SIGCONT
until every robot has moved on a command. Simulation time must not go back, and the server must not
catch up: the next second has at most as many steps as any other.
"""

import signal
import time
from collections.abc import Iterator

from benchmarks.figures import Figure, Limit
from tests.chaos.recovery import ROBOTS, ROBOTS_WHEN_SHORT, DrivenFleet, run_driven_fleet
from tests.integration.processes import kill, serving

ROUNDS, ROUNDS_WHEN_SHORT = 5, 1
DOWN_S, DOWN_WHEN_SHORT_S = 30.0, 4.0
NOMINAL_STEPS = 240


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Suspend the server and resume it."""
    back, rates = [], []
    with (
        serving() as server,
        run_driven_fleet(server.endpoint, ROBOTS_WHEN_SHORT if is_short else ROBOTS) as found,
    ):
        found.drive_s()
        for _ in range(ROUNDS_WHEN_SHORT if is_short else ROUNDS):
            kill(server.process.pid, signal.SIGSTOP)
            time.sleep(DOWN_WHEN_SHORT_S if is_short else DOWN_S)
            found.read_clock()
            last = found.clock.last[1]
            found.clock.received.clear()
            went_on_s = time.monotonic()
            kill(server.process.pid, signal.SIGCONT)
            back.append(found.drive_s())
            rates.append(_steps_in_first_second(found, went_on_s, last))
        steps_back = float(found.clock.steps_back)
    yield Figure(
        what="server going on to all robots driving",
        unit="s",
        samples=tuple(back),
        limit=Limit("max", "<=", 5.0, is_timed=True),
    )
    yield Figure(
        what="steps in the second after, of those in any other",
        unit="",
        samples=tuple(rates),
        limit=Limit("max", "<=", 1.1),
    )
    yield Figure(
        what="times that the clock went back",
        unit="",
        samples=(steps_back,),
        limit=Limit("max", "<=", 0.0),
    )


def _steps_in_first_second(found: DrivenFleet, went_on_s: float, last: int) -> float:
    while time.monotonic() < went_on_s + 1.0:
        found.read_clock()
    early = [step for told_s, step in found.clock.received if told_s < went_on_s + 1.0]
    return (max(early, default=last) - last) / NOMINAL_STEPS
