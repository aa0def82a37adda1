"""Drives of the robots of many equal worlds, in arrays: a row for each robot of each world."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from zensim.proto.messages.drive_messages import Drive
from zensim.proto.messages.model_messages import Model
from zensim.robot_agent.pool.group_bases import VX, VY, WZ, GroupDrive
from zensim.robot_agent.robot_frames import get_drive
from zensim.robot_agent.robot_rows import NEW_ROW, BoolArray, FloatArray, GroupRateLimiter, IntArray

TWIST_COLUMNS = 6
PlaceArray = npt.NDArray[np.intp]
SavedDrives = tuple[FloatArray, tuple[BoolArray, IntArray, IntArray]]
"""State of the drives, and the openings of their rate limiters."""


class _KindKey(NamedTuple):
    """What robots of one kind have in common."""

    drive: Drive
    measured: tuple[int, ...]
    targets: int


class _DrivesOfKind:
    """The drives of all robots of one kind; rows world by world."""

    def __init__(
        self, kind: _KindKey, places: list[int], starts: tuple[PlaceArray, PlaceArray], worlds: int
    ) -> None:
        """Find the indexes.

        Args:
            kind: Of all of them.
            places: (n,) of the robots in their world.
            starts: (robots,) first joint and first target of each robot of a world.
            worlds: Number of worlds.
        """
        self._places = np.array(places, np.intp)
        first_joints, first_targets = (start[self._places][:, None] for start in starts)
        self._joints = first_joints + np.array(kind.measured, np.intp)
        self._targets = first_targets + np.arange(kind.targets)
        rows = worlds * len(places)
        self._drive = GroupDrive(kind.drive)
        self._limiters = GroupRateLimiter(kind.drive.update_rate_hz)
        self._twists = np.zeros((rows, TWIST_COLUMNS))
        for part in (self._drive, self._limiters):
            part.remap(np.full(rows, NEW_ROW))

    def update(
        self,
        time_ns: int,
        joints: tuple[FloatArray, FloatArray],
        twists: FloatArray,
        targets: FloatArray,
    ) -> None:
        """Write the targets of the drives that are due.

        Args:
            time_ns: Since the batch was made.
            joints: Positions and velocities (worlds, k).
            twists: (worlds, robots, 3).
            targets: (worlds, t); written.
        """
        due, elapsed_s = self._limiters.open(time_ns)
        if not len(due):
            return
        own = twists[:, self._places].reshape(-1, 3)
        self._twists[:, (VX, VY, WZ)] = own
        measured = self._joints.shape[1]
        positions, velocities = (
            values[:, self._joints].reshape(len(self._twists), measured) for values in joints
        )
        self._drive.begin(time_ns)
        found = self._drive.update(
            due,
            self._twists[due],
            positions=positions[due],
            velocities=velocities[due],
            elapsed_s=elapsed_s,
        )
        world, place = np.divmod(due, len(self._places))
        targets[world[:, None], self._targets[place]] = found

    def save(self) -> SavedDrives:
        """Copy the states of the drives."""
        return self._drive.save(), self._limiters.save()

    def load(self, saved: SavedDrives) -> None:
        """Put back what `save` returned."""
        self._drive.load(saved[0])
        self._limiters.load(saved[1])

    def restart(self, worlds: BoolArray) -> None:
        """Start the drives of some worlds (worlds,) anew."""
        rows = np.flatnonzero(np.repeat(worlds, len(self._places)))
        self._drive.reset(rows)
        self._limiters.reset(rows)


class BatchDrives:
    """Converts twists to the targets of all actuators, as agents do.

    Attributes:
        targets: (worlds, t), robot by robot in the order of their actuators.
    """

    def __init__(self, models: Sequence[Model], joint_starts: PlaceArray, worlds: int) -> None:
        """Group the robots by kind.

        Args:
            models: Of the robots of a world.
            joint_starts: (robots,) first joint of each among those that are read.
            worlds: Number of worlds.
        """
        kinds: dict[_KindKey, list[int]] = {}
        for place, model in enumerate(models):
            kinds.setdefault(_find_kind(model), []).append(place)
        ends = np.cumsum([model.target_count for model in models], dtype=np.intp)
        first_targets = np.concatenate([np.zeros(1, np.intp), ends[:-1]])
        self.targets = np.zeros((worlds, int(ends[-1])))
        self._kinds = [
            _DrivesOfKind(kind, places, (joint_starts, first_targets), worlds)
            for kind, places in kinds.items()
        ]

    def update(
        self, time_ns: int, joints: tuple[FloatArray, FloatArray], twists: FloatArray
    ) -> None:
        """Update the targets of what is due.

        Args:
            time_ns: Since the batch was made.
            joints: Positions and velocities (worlds, k) of all joints that are read.
            twists: Forward, left [m/s] and turn [rad/s] of the bases, (worlds, robots, 3).
        """
        for kind in self._kinds:
            kind.update(time_ns, joints, twists, self.targets)

    def save(self) -> tuple[FloatArray, tuple[SavedDrives, ...]]:
        """Copy targets, and the states of all drives."""
        return self.targets.copy(), tuple(kind.save() for kind in self._kinds)

    def load(self, saved: tuple[FloatArray, tuple[SavedDrives, ...]]) -> None:
        """Put back what `save` returned."""
        self.targets[:] = saved[0]
        for kind, one in zip(self._kinds, saved[1], strict=True):
            kind.load(one)

    def restart(self, worlds: BoolArray) -> None:
        """Start the drives of some worlds (worlds,) anew."""
        for kind in self._kinds:
            kind.restart(worlds)


def _find_kind(model: Model) -> _KindKey:
    index = {joint.name: place for place, joint in enumerate(model.joints)}
    actuators = model.drive_actuators
    measured = tuple(index[one.joint] for one in actuators if one.joint)
    return _KindKey(get_drive(model), measured, sum(one.width for one in actuators))
