"""The newest odometry of all robots of a world, from the messages of their agents."""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from zensim.api.world_state import FloatArray
from zensim.proto.messages.agent_messages import STATE_COLUMNS, FleetOdometry
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.spawner.client.topic_reader import TopicReader

IntArray: TypeAlias = npt.NDArray[np.intp]
POSE_NUMBERS = 7
OLD_EPOCH_S = 2.0
"""Time without a message of the newest epoch after which an older one is that of a new server."""
TABLE_DEPTH = 512
"""Messages of 64 KiB that wait: of 10,000 robots, some 20 a step."""
MAX_KNOWN_NAMES = 256
"""Lists of names whose rows are kept: at most steps an agent sends the same lists."""


@dataclass(frozen=True)
class FleetOdometryRows:
    """Newest odometry of several robots, a row for each; NaN where none has come.

    Attributes:
        times: Stamps [s of simulation time], (n,).
        poses: Position [m] and quaternion x y z w in each robot's odometry frame, (n, 7).
        twists: Linear [m/s] and angular [rad/s] velocity of each base in its own frame, (n, 6).
    """

    times: FloatArray
    poses: FloatArray
    twists: FloatArray


class OdometryTable:
    """Keeps the last odometry of each robot of a feed."""

    def __init__(
        self, feed: TopicReader[FleetOdometry], clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Take the feed of all agents.

        Args:
            feed: Of all agents; messages of one of them may be later than a reset.
            clock: Wall time [s].
        """
        self._feed = feed
        self._clock = clock
        self._epoch, self._newest_s = 0, -math.inf
        self._rows: dict[str, int] = {}
        self._rows_of: dict[tuple[str, ...], IntArray] = {}
        """Rows by the names of a whole message."""
        self._found: tuple[tuple[str, ...], int, IntArray] = ((), 0, np.zeros(0, dtype=np.intp))
        """Names of the last call, the number of rows then, and the row of each."""
        self._times = np.zeros(0)
        self._motions = np.zeros((0, STATE_COLUMNS))

    def read(self, names: Sequence[str]) -> FleetOdometryRows:
        """Take what has come, and read the rows of some robots."""
        for message in self._feed.take():
            self._add(message)
        rows = self._find_rows(tuple(names))
        if (rows >= 0).all():
            times, motions = self._times[rows], self._motions[rows]
        else:
            is_known = rows >= 0
            times = np.full(len(rows), np.nan)
            motions = np.full((len(rows), STATE_COLUMNS), np.nan)
            times[is_known] = self._times[rows[is_known]]
            motions[is_known] = self._motions[rows[is_known]]
        for array in (times, motions):
            array.flags.writeable = False
        return FleetOdometryRows(times, motions[:, :POSE_NUMBERS], motions[:, POSE_NUMBERS:])

    def close(self) -> None:
        """End the subscription."""
        self._feed.close()

    def _find_rows(self, names: tuple[str, ...]) -> IntArray:
        """Find the row of each name, -1 of an unknown one."""
        before, count, rows = self._found
        if count != len(self._rows) or before != names:
            rows = np.array([self._rows.get(name, -1) for name in names], dtype=np.intp)
            self._found = names, len(self._rows), rows
        return rows

    def _add(self, message: FleetOdometry) -> None:
        if len(message.motions) != 8 * STATE_COLUMNS * len(message.entities):
            return
        now_s = self._clock()
        if message.epoch < self._epoch and now_s - self._newest_s < OLD_EPOCH_S:
            return
        self._newest_s = now_s
        if message.epoch != self._epoch:
            # Time has begun again: robots of before may be gone.
            self._epoch, self._rows, self._rows_of = message.epoch, {}, {}
            self._found = (), 0, np.zeros(0, dtype=np.intp)
        rows = self._add_rows(message.entities)
        if len(self._rows) > len(self._times):
            more = 2 * len(self._rows)
            self._times = np.resize(self._times, more)
            self._motions = np.resize(self._motions, (more, STATE_COLUMNS))
        self._times[rows] = message.time_ns / NANOSECONDS
        self._motions[rows] = np.frombuffer(message.motions, dtype="<f8").reshape(-1, STATE_COLUMNS)

    def _add_rows(self, names: tuple[str, ...]) -> IntArray:
        """Find the rows of the names of a message; new ones get a row."""
        if (known := self._rows_of.get(names)) is not None:
            return known
        found = [self._rows.setdefault(name, len(self._rows)) for name in names]
        if len(self._rows_of) >= MAX_KNOWN_NAMES:
            self._rows_of.clear()
        rows = self._rows_of[names] = np.array(found, dtype=np.intp)
        return rows
