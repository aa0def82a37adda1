"""What the vehicles of a world do, as one or more programs say once a second."""

import time
from collections.abc import Callable, Mapping
from typing import Final

from zensim.proto.messages.vehicle_messages import FleetStatus, VehicleStatus

STALE_S: Final = 4.0
"""Time after which what was said of a vehicle does not count any more."""


class VehicleStatuses:
    """The last status of each vehicle."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Know of no vehicle yet; the clock is wall time from any origin [s]."""
        self._clock = clock
        self._last: dict[str, tuple[float, VehicleStatus]] = {}

    def receive(self, fleet: FleetStatus) -> None:
        """Take the report of a program."""
        now_s = self._clock()
        self._last |= {one.entity: (now_s, one) for one in fleet.vehicles}

    def find(self, entity: str) -> VehicleStatus | None:
        """Find the status of a vehicle; None if nothing was said of it for `STALE_S`."""
        heard_s, status = self._last.get(entity, (-float("inf"), None))
        return status if self._clock() - heard_s <= STALE_S else None

    def read(self) -> Mapping[str, VehicleStatus]:
        """Read the statuses that count now, by entity; others are forgotten."""
        least_s = self._clock() - STALE_S
        self._last = {name: one for name, one in self._last.items() if one[0] >= least_s}
        return {name: status for name, (_, status) in self._last.items()}
