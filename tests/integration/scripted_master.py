"""A master that sends vehicles squares, and measures when they move."""

import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.integration.brokers import Broker, Master, State, serving_broker
from tests.integration.processes import eventually, running
from tests.zensim.vda5050.orders import line

CORNERS = ((0.0, 0.0), (1.5, 0.0), (1.5, 1.5), (0.0, 1.5), (0.0, 0.0))
READY_S = 300.0
PARTS = 100
"""Parts of the first orders, with a pause between them."""
PAUSE_S = 0.1


class ScriptedMaster(Master):
    """Sends a square to a vehicle, and the next one when it is back."""

    def __init__(self, broker: Broker) -> None:
        self.moved_s: list[float] = []
        """Wall time from each order to the state with `driving`."""
        self._homes: dict[str, tuple[float, float]] = {}
        self._sent: dict[str, tuple[str, float]] = {}
        super().__init__(broker)

    def wait_for(self, count: int) -> None:
        """Wait for the states of so many vehicles."""
        eventually(lambda: len(self._homes) == count, READY_S, "states")

    def begin(self) -> None:
        """Send the first order to each vehicle."""
        robots = list(self._homes)
        for at, robot in enumerate(robots):
            self._send_square(robot)
            time.sleep(PAUSE_S if at % max(1, len(robots) // PARTS) == 0 else 0.0)

    def add(self, robot: str, topic: str, message: State) -> None:
        """Note that a vehicle moves; send one that is back its next order."""
        if topic != "state":
            return
        where, is_driving = message["agvPosition"], message["driving"]
        self._homes.setdefault(robot, (where["x"], where["y"]))
        name, sent_s = self._sent.get(robot, ("", 0.0))
        if not name or name != message["orderId"]:
            return
        if is_driving and sent_s:
            self.moved_s.append(time.monotonic() - sent_s)
            self._sent[robot] = name, 0.0
        elif not message["nodeStates"] and not is_driving:
            self._send_square(robot)

    def _send_square(self, robot: str) -> None:
        x, y = self._homes[robot]
        name = f"{robot}-{time.monotonic_ns()}"
        self._sent[robot] = name, time.monotonic()
        self.send(robot, "order", line(*((x + a, y + b) for a, b in CORNERS), name=name))


@contextmanager
def running_vehicles(
    endpoint: str, options: Sequence[str] = ()
) -> Iterator[tuple[ScriptedMaster, int]]:
    """Run a broker, the vehicles of a world and their master; the number is the program's id."""
    with TemporaryDirectory() as scratch, serving_broker(Path(scratch)) as broker:
        words = ("vda5050", "--broker", broker.url, "--connect", endpoint, *options)
        with closing(ScriptedMaster(broker)) as master, running(*words) as program:
            yield master, program.pid
