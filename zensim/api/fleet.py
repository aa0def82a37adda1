"""Fleet: several robots of one simulation in arrays, a row for each."""

from collections.abc import Iterator, Mapping, Sequence
from typing import overload

import numpy as np
import numpy.typing as npt

from zensim.api.api_errors import Invalid, refuse_pickling
from zensim.api.argument_checks import check_limits
from zensim.api.entity_values import SpawnReport, make_html_table
from zensim.api.odometry_table import FleetOdometryRows, IntArray
from zensim.api.robot import Robot
from zensim.api.world_access import api_errors
from zensim.api.world_session import RELEASED, WorldSession
from zensim.api.world_state import POSE, FloatArray, WorldState
from zensim.proto.drives.array_math import ARRAY_MATH
from zensim.proto.rigid_transforms import find_yaw

HTML_ROWS = 10
SHOWN_NAMES = 3
BoolArray = npt.NDArray[np.bool_]


class Fleet:
    """Several robots; rows stay when robots are deleted, and are then NaN.

    Attributes:
        report: Of the spawn; `report.refused` has the robots that were not spawned.
    """

    def __init__(
        self, session: WorldSession, names: Sequence[str], report: SpawnReport | None = None
    ) -> None:
        self.report = report or SpawnReport()
        self._session = session
        self._names = tuple(names)
        self._rows: tuple[Mapping[str, int], IntArray] | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names, in the order of rows."""
        return self._names

    @property
    def alive(self) -> BoolArray:
        """Whether each robot exists, (n,)."""
        _, rows = self._find_rows()
        return rows >= 0

    def __len__(self) -> int:
        return len(self._names)

    def __iter__(self) -> Iterator[Robot]:
        return (Robot(self._session, name) for name in self._names)

    @overload
    def __getitem__(self, which: int) -> Robot: ...
    @overload
    def __getitem__(self, which: "slice | Sequence[bool] | BoolArray | IntArray") -> "Fleet": ...
    def __getitem__(self, which: object) -> "Robot | Fleet":
        """Return one robot by its row, or the fleet of a mask, slice or array of rows."""
        if isinstance(which, int | np.integer):
            if not -len(self) <= which < len(self):
                raise IndexError(f"row {which} is not one of {len(self)} robots; count from 0")
            return Robot(self._session, self._names[int(which)])
        try:
            rows = np.arange(len(self._names))[which]  # type: ignore[call-overload]
        except IndexError as error:
            raise Invalid(
                f"rows {which!r} do not fit {len(self)} robots",
                slug="wrong_shape",
                hint="use a row, a slice, rows, or a mask (n,)",
            ) from error
        return Fleet(self._session, [self._names[row] for row in rows], self.report)

    def poses(self) -> FloatArray:
        """Position [m] and quaternion x y z w of each robot in the world, (n, 7)."""
        state, rows = self._find_rows()
        return _take(state.base[:, POSE], rows)

    def poses2d(self) -> FloatArray:
        """Position x y [m] and heading [rad] of each robot in the world, (n, 3)."""
        poses = self.poses()
        x, y, z, w = poses[:, 3:7].T
        found = np.column_stack([poses[:, :2], find_yaw((x, y, z, w), ARRAY_MATH)])
        found.flags.writeable = False
        return found

    def twists(self) -> FloatArray:
        """Linear [m/s] and angular [rad/s] velocity of each robot in its own frame, (n, 6)."""
        state, rows = self._find_rows()
        return _take(state.twists, rows)

    def odometry(self) -> FleetOdometryRows:
        """Newest odometry of each robot, as on its topic `odom`, by one subscription for all.

        The first call subscribes, so its rows are NaN: odometry comes with the next steps. So are
        the rows of robots without odometry, and of those whose odometry has a fault.
        """
        return self._session.odometry().read(self._names)

    def drive(
        self, v: npt.ArrayLike = 0.0, w: npt.ArrayLike = 0.0, *, left: npt.ArrayLike = 0.0
    ) -> None:
        """Order twists in one message, which hold until the next order or `stop`.

        Args:
            v: Forward velocity [m/s]: a number, or one for each robot (n,).
            w: Angular velocity [rad/s], positive to the left.
            left: Velocity to the left [m/s], for robots that can move sideways.
        """
        self._session.check_open()
        twists = np.empty((len(self._names), 3))
        try:
            twists[:, 0], twists[:, 1], twists[:, 2] = v, left, w
        except (TypeError, ValueError) as error:
            shapes = ", ".join(str(np.shape(given)) for given in (v, left, w))
            raise Invalid(
                f"v, left and w have shapes {shapes}",
                slug="wrong_shape",
                hint=f"give a number or ({len(self)},) for each",
            ) from error
        check_limits("twists", twists, f"({len(self)},)")
        self._order(twists)

    def stop(self) -> None:
        """Order a twist of zero for each robot."""
        self.drive(0.0, 0.0)

    def release(self) -> None:
        """End the orders, so that only `cmd_vel` counts."""
        self._session.check_open()
        self._order(np.tile(RELEASED, (len(self._names), 1)))

    def delete(self) -> None:
        """Delete the robots that exist."""
        self._session.check_open()
        alive = self.alive
        with api_errors():
            for name in np.array(self._names)[alive].tolist():
                self._session.client.delete(name)
        self._session.access.refresh()

    def _order(self, twists: FloatArray) -> None:
        alive = self.alive
        if alive.all():
            self._session.order(self._names, twists)
            return
        names = [name for name, is_alive in zip(self._names, alive, strict=True) if is_alive]
        if names:
            self._session.order(names, twists[alive])

    def _find_rows(self) -> tuple[WorldState, IntArray]:
        state = self._session.state()
        if self._rows is None or self._rows[0] is not state.row:
            found = [state.row.get(name, -1) for name in self._names]
            self._rows = state.row, np.array(found, dtype=np.intp)
        return state, self._rows[1]

    def _repr_html_(self) -> str:
        state, rows = self._find_rows()
        shown = [
            (name, *(f"{number:.3f}" for number in state.base[row, :3]))
            for name, row in zip(self._names[:HTML_ROWS], rows[:HTML_ROWS], strict=True)
            if row >= 0
        ]
        return f"<p>{len(self)} robots</p>" + make_html_table(("name", "x", "y", "z"), shown)

    def __repr__(self) -> str:
        """Write the count and the first names."""
        shown = [*self._names[:SHOWN_NAMES], *["…"] * (len(self) > SHOWN_NAMES)]
        return f"Fleet({len(self)} robots: {', '.join(shown) or 'none'})"

    def __reduce__(self) -> tuple[object, ...]:
        """Refuse: a handle belongs to its process."""
        refuse_pickling(self, "pass sim.endpoint and fleet.names")


def _take(values: FloatArray, rows: IntArray) -> FloatArray:
    found = values.take(rows, axis=0, mode="clip") if len(values) else np.empty((len(rows), 7))
    if (rows < 0).any():
        found[rows < 0] = np.nan
    found.flags.writeable = False
    return found
