"""All kinematic robots as arrays: motors, twists, rolling wheels and arcs of one step."""

import math
from dataclasses import dataclass, field

import numpy as np

from zensim.proto.messages.drive_messages import JointTargetKind
from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.kinematic.collision_limits import STOPPING_GAP_M, DiscMotions
from zensim.sim_server.physics.kinematic.planar_vehicle import PlanarVehicle
from zensim.sim_server.physics.kinematic.tier_body_table import (
    ArrayPool,
    RowSelection,
    Tier,
    TierBodyTable,
    rotate_by_heading,
    select_rows,
)
from zensim.sim_server.scene.broad_phase import IntArray, expand_ranges

MIN_TURN_RAD = 1e-300
"""Replaces a zero rotation, for which an arc has no radius."""
ROUNDING = 1.0 + 1e-9
"""Enlarges a part of a way, so that the last part reaches the end in spite of rounding."""


def ramp_towards(now: FloatArray, wanted: FloatArray, most: FloatArray | float) -> FloatArray:
    """Change values towards wanted ones, by at most `most`."""
    return np.minimum(np.maximum(wanted, now - most), now + most)


def extend(numbers: FloatArray, count: int) -> FloatArray:
    """Append zeros up to a count; the array itself if it has as many."""
    missing = count - len(numbers)
    return np.concatenate([numbers, np.zeros(missing)]) if missing else numbers


def multiply_columns(matrix: FloatArray, speeds: FloatArray) -> FloatArray:
    """Compute root twists (3, n) by speeds (n, k) of wheels; a row never depends on the others."""
    found = matrix[:, :1] * speeds[:, 0]
    for wheel in range(1, speeds.shape[1]):
        found += matrix[:, wheel : wheel + 1] * speeds[:, wheel]
    return np.asarray(found)


def compute_steered_twists(
    vehicle: PlanarVehicle, speeds: FloatArray, angles: FloatArray
) -> FloatArray:
    """Compute root twists (3, n) of cars and tricycles, which turn about their unsteered axle.

    Args:
        vehicle: Common to all n.
        speeds: (n, k) of the driven wheels [rad/s].
        angles: (n, s) of the steering joints [rad].
    """
    ahead, turn = np.zeros(len(speeds)), np.zeros(len(speeds))
    for wheel in vehicle.wheels:
        if wheel.steering >= 0:
            x, y = _offset_from_axle(vehicle, wheel.place)
            sin, cos = np.sin(angles[:, wheel.steering]), np.cos(angles[:, wheel.steering])
            # Of two axles with opposite angles, both turn it the same way.
            side = math.copysign(1.0, x)
            ahead += side * (x * cos + y * sin)
            turn += side * sin
    pulled, square = np.zeros(len(speeds)), np.full(len(speeds), 1e-12)
    for number, wheel in enumerate(vehicle.wheels[: speeds.shape[1]]):
        rim = _rim_speeds(vehicle, number, ahead, turn, angles)
        pulled += rim * speeds[:, number] * wheel.radius_m
        square += rim * rim
    share = pulled / square
    x, y = vehicle.axle
    spin = share * turn
    return np.stack([share * ahead + spin * y, -spin * x, spin])


def compute_rolling_speeds(
    vehicle: PlanarVehicle, twists: FloatArray, angles: FloatArray
) -> FloatArray:
    """Compute speeds (n, w) [rad/s] of the w passive wheels from root twists (3, n)."""
    turn = twists[2]
    ahead = twists[0] - turn * vehicle.axle[1]
    driven = len(vehicle.driven.joints)
    found = np.zeros((twists.shape[1], len(vehicle.wheels) - driven))
    for at, wheel in enumerate(vehicle.wheels[driven:]):
        rim = _rim_speeds(vehicle, driven + at, ahead, turn, angles)
        found[:, at] = rim / wheel.radius_m
    return found


def _rim_speeds(
    vehicle: PlanarVehicle, number: int, ahead: FloatArray, turn: FloatArray, angles: FloatArray
) -> FloatArray:
    """Compute rim speeds (n,) [m/s] from the speed ahead and yaw rate of the axle."""
    wheel = vehicle.wheels[number]
    x, y = _offset_from_axle(vehicle, wheel.place)
    forward, aside = ahead - turn * y, turn * x
    if wheel.steering >= 0:
        angle = angles[:, wheel.steering]
        forward = np.cos(angle) * forward + np.sin(angle) * aside
    return np.asarray(forward * wheel.ahead[0])


def _offset_from_axle(vehicle: PlanarVehicle, place: tuple[float, float]) -> tuple[float, float]:
    return place[0] - vehicle.axle[0], place[1] - vehicle.axle[1]


def integrate_arcs(
    heading: tuple[FloatArray, FloatArray], twists: FloatArray, dt_s: FloatArray | float
) -> FloatArray:
    """Compute displacements (3, n) in the world, x, y, yaw, at constant twists.

    Args:
        heading: Cosines and sines (n,) at the start.
        twists: (3, n) vx, vy [m/s] along the heading and to its left, wz [rad/s].
        dt_s: Duration; (n,) or one for all.
    """
    turn = twists[2] * dt_s
    half = turn * 0.5
    half[half == 0.0] = MIN_TURN_RAD
    sin = np.sin(half)
    chord = sin / half * dt_s
    along, across = chord * np.cos(half), chord * sin
    ahead = twists[0] * along - twists[1] * across
    left = twists[0] * across + twists[1] * along
    return np.stack([*rotate_by_heading(ahead, left, heading), turn])


TIPPING_SPEED_CHANGE_M_S = 0.1
"""A change of speed that may tip over a vehicle that can tip."""
NO_TWISTS = np.zeros((3, 0))
CLEARABLE_HEIGHT_M = 0.01
"""Obstacles up to this height above the lowest point of a robot do not stop it."""


@dataclass
class VehicleGroup:
    """Robots with the same vehicle.

    Attributes:
        all_rows: Of the members.
        rows: (n,) of those in the kinematic tier.
        joints: (n, j) indices of their joints in the pool.
        targets: (n, w) indices of their targets.
        driven, driven_targets: (n, k) indices for the driven wheels.
        wheels: (n, m) indices of the joints of all wheels.
        matrix: (3, k) root twists by wheel speeds.
        radii: (k,) of driven wheels [m].
    """

    vehicle: PlanarVehicle
    matrix: FloatArray
    radii: FloatArray
    members: set[int] = field(default_factory=set)
    all_rows: IntArray = field(default_factory=lambda: np.zeros(0, np.intp))
    rows: IntArray = field(default_factory=lambda: np.zeros(0, np.intp))
    joints: IntArray = field(default_factory=lambda: np.zeros((0, 0), np.intp))
    targets: IntArray = field(default_factory=lambda: np.zeros((0, 0), np.intp))
    driven: IntArray = field(default_factory=lambda: np.zeros((0, 0), np.intp))
    driven_targets: IntArray = field(default_factory=lambda: np.zeros((0, 0), np.intp))
    wheels: IntArray = field(default_factory=lambda: np.zeros((0, 0), np.intp))
    _added: list[int] = field(default_factory=list)
    """Members that `all_rows` lacks."""
    _has_lost: bool = False
    """Whether `all_rows` has rows of members that are gone."""

    def add(self, row: int) -> None:
        """Add a member."""
        self.members.add(row)
        self._added.append(row)

    def remove(self, row: int) -> None:
        """Remove a member."""
        self.members.discard(row)
        self._has_lost = True

    def gather(self, rows: TierBodyTable) -> None:
        """Find the members in the kinematic tier, and their indices."""
        if self._has_lost:
            self.all_rows, self._added = np.array(sorted(self.members), np.intp), []
        elif self._added:
            added = np.array(self._added, np.intp)
            self.all_rows, self._added = np.sort(np.concatenate([self.all_rows, added])), []
        self._has_lost = False
        members = self.all_rows
        self.rows = members[rows.tier[members] == Tier.KINEMATIC]
        counts = np.arange(self.vehicle.joint_count)
        self.joints = rows.joint_start[self.rows][:, None] + counts
        self.targets = rows.target_start[self.rows][:, None] + np.arange(self.vehicle.width)
        self.driven = self.joints[:, list(self.vehicle.driven.joints)]
        self.driven_targets = self.targets[:, list(self.vehicle.driven.places)]
        self.wheels = self.joints[:, [wheel.joint for wheel in self.vehicle.wheels]]


def make_vehicle_group(vehicle: PlanarVehicle) -> VehicleGroup:
    """Make a group without members."""
    radii = [wheel.radius_m for wheel in vehicle.wheels[: len(vehicle.driven.joints)]]
    return VehicleGroup(vehicle, np.array(vehicle.matrix).reshape(3, -1), np.array(radii))


class KinematicRobots:
    """Joints, targets and motions of all robots that may be in the kinematic tier.

    Attributes:
        rows: Of those in the kinematic tier, vehicle by vehicle.
    """

    def __init__(self, rows: TierBodyTable, dt_s: float, period_steps: int = 1) -> None:
        """Make it without robots; joints reach new positions in `period_steps`."""
        self.rows: IntArray = np.zeros(0, np.intp)
        self._at: RowSelection = self.rows
        self._has_offset_discs = False
        self.positions = ArrayPool()
        self.velocities: FloatArray = np.zeros(0)
        self.targets = ArrayPool()
        self._table = rows
        self._dt_s = dt_s
        self._period_steps = period_steps
        self._aims: FloatArray = np.zeros(0)
        """Positions that joints were commanded to, at the places of these targets; else nan."""
        self._paces: FloatArray = np.zeros(0)
        """Ways [rad, m] of a step to these positions."""
        self._groups: dict[PlanarVehicle, VehicleGroup] = {}
        self._vehicles: dict[int, PlanarVehicle] = {}

    def add(self, row: int, vehicle: PlanarVehicle) -> None:
        """Add a robot with joints and targets at zero."""
        table = self._table
        table.joint_start[row] = self.positions.allocate(vehicle.joint_count)
        table.target_start[row] = self.targets.allocate(vehicle.width)
        self.velocities = extend(self.velocities, len(self.positions.numbers))
        self._aims = extend(self._aims, len(self.targets.numbers))
        self._paces = extend(self._paces, len(self.targets.numbers))
        self.set_joints(row, np.zeros(vehicle.joint_count), np.zeros(vehicle.joint_count))
        self.set_targets(row, np.zeros(vehicle.width))
        if (group := self._groups.get(vehicle)) is None:
            group = self._groups[vehicle] = make_vehicle_group(vehicle)
        group.add(row)
        self._vehicles[row] = vehicle

    def remove(self, row: int) -> None:
        """Remove a robot."""
        vehicle = self._vehicles.pop(row)
        self._groups[vehicle].remove(row)
        self.positions.free(int(self._table.joint_start[row]), vehicle.joint_count)
        self.targets.free(int(self._table.target_start[row]), vehicle.width)

    def tile(self, table: TierBodyTable, rows: IntArray, copies: int) -> "KinematicRobots":
        """Make the robots of a table tiled by these rows; see `TierBodyTable.tile`."""
        own, found = self._table, KinematicRobots(table, self._dt_s, self._period_steps)
        joints = expand_ranges(own.joint_start[rows], own.joint_count[rows])[1]
        targets = expand_ranges(own.target_start[rows], own.width[rows])[1]
        found.positions.numbers = np.tile(self.positions.numbers[joints], copies)
        found.velocities = np.tile(self.velocities[joints], copies)
        found.targets.numbers = np.tile(self.targets.numbers[targets], copies)
        found._aims = np.tile(self._aims[targets], copies)
        found._paces = np.tile(self._paces[targets], copies)
        starts = np.arange(copies)[:, None] * len(rows)
        for vehicle, group in self._groups.items():
            members = np.flatnonzero(np.isin(rows, group.all_rows))
            copied = make_vehicle_group(vehicle)
            copied.all_rows = (starts + members).reshape(-1)
            found._groups[vehicle] = copied
        found.gather()
        return found

    def vehicle(self, row: int) -> PlanarVehicle:
        """Find the vehicle of a robot."""
        return self._vehicles[row]

    def gather(self) -> None:
        """Update the rows after robots came, went or changed tiers."""
        for group in self._groups.values():
            group.gather(self._table)
        self.rows = np.concatenate([self.rows[:0], *(m.rows for m in self._groups.values())])
        self._at = select_rows(self.rows)
        self._has_offset_discs = bool(self._table.centre[:, self._at].any())

    def joints(self, row: int) -> tuple[FloatArray, FloatArray]:
        """Copy positions and velocities (j,) of the joints of a robot."""
        span = self._joints(row)
        return self.positions.numbers[span].copy(), self.velocities[span].copy()

    def set_joints(self, row: int, positions: FloatArray, velocities: FloatArray) -> None:
        """Set the joints of a robot."""
        self.positions.numbers[self._joints(row)] = positions
        self.velocities[self._joints(row)] = velocities
        start = int(self._table.target_start[row])
        self._aims[start : start + int(self._table.width[row])] = np.nan

    def view_state(self) -> list[FloatArray]:
        """View what changes in steps: numbers of joints, and of targets."""
        found = [self.positions.numbers, self.velocities, self.targets.numbers]
        is_paced = self._period_steps > 1 and any(one.moved for one in self._groups)
        return [*found, self._aims, self._paces] if is_paced else found

    def targets_of(self, row: int) -> FloatArray:
        """View the targets (w,) of a robot."""
        start = int(self._table.target_start[row])
        return self.targets.numbers[start : start + int(self._table.width[row])]

    def set_targets(self, row: int, targets: FloatArray) -> None:
        """Set the targets of a robot."""
        self.targets_of(row)[:] = targets

    def twist(self, row: int) -> FloatArray:
        """Compute the root twist (3,) of a robot from its joints and targets."""
        vehicle = self._vehicles[row]
        if vehicle.twist >= 0:
            return self.targets_of(row)[vehicle.twist : vehicle.twist + 3]
        positions, velocities = (numbers[None] for numbers in self.joints(row))
        speeds = velocities[:, list(vehicle.driven.joints)]
        if vehicle.matrix:
            return np.asarray(self._groups[vehicle].matrix @ speeds[0])
        angles = positions[:, list(vehicle.steering)]
        return compute_steered_twists(vehicle, speeds, angles)[:, 0]

    def update_speed_bounds(self) -> None:
        """Bound the speeds of all robots, in either tier, by their targets and twists."""
        table = self._table
        for group in self._groups.values():
            vehicle, rows = group.vehicle, group.all_rows
            if not len(rows):
                continue
            widths, counts = np.arange(vehicle.width), np.arange(vehicle.joint_count)
            targets = self.targets.numbers[table.target_start[rows][:, None] + widths]
            now = self.velocities[table.joint_start[rows][:, None] + counts]
            ahead, aside, spin = np.abs(table.twist[:, rows])
            rims, change = _commanded_rim_speeds(vehicle, targets, now)
            table.pace[rows] = np.maximum(np.hypot(ahead, aside) + spin * table.radius[rows], rims)
            is_pulled = vehicle.can_tip & (change > TIPPING_SPEED_CHANGE_M_S)
            table.exceeds_limits[rows] = is_pulled | (ahead * spin > vehicle.max_lateral_accel)

    def propose_motions(self) -> tuple[FloatArray, FloatArray]:
        """Advance motors by a step; compute root twists and displacements (3, n) of `rows`."""
        for group in self._groups.values():
            if group.vehicle.moved and len(group.rows):
                self._move_joints(group)
        twists = [self._driven(group) for group in self._groups.values() if len(group.rows)]
        found = twists[0] if len(twists) == 1 else np.concatenate([NO_TWISTS, *twists], axis=1)
        return found, integrate_arcs(self._table.headings(self._at), found, self._dt_s)

    def _driven(self, group: VehicleGroup) -> FloatArray:
        vehicle, positions = group.vehicle, self.positions.numbers
        if vehicle.twist >= 0:
            twists = self.targets.numbers[group.targets[:, vehicle.twist : vehicle.twist + 3]]
            self.velocities[group.driven] = self.targets.numbers[group.driven_targets]
            return np.ascontiguousarray(twists.T)
        most = vehicle.max_rim_accel * self._dt_s / group.radii
        targets = self.targets.numbers[group.driven_targets]
        speeds = ramp_towards(self.velocities[group.driven], targets, most)
        self.velocities[group.driven] = speeds
        if vehicle.matrix:
            return multiply_columns(group.matrix, speeds)
        self._steer(group)
        angles = positions[group.joints[:, list(vehicle.steering)]]
        twists = compute_steered_twists(vehicle, speeds, angles)
        rolling = [wheel.joint for wheel in vehicle.wheels[len(vehicle.driven.joints) :]]
        self.velocities[group.joints[:, rolling]] = compute_rolling_speeds(vehicle, twists, angles)
        return twists

    def _move_joints(self, group: VehicleGroup) -> None:
        """Advance controlled joints; without dynamics, an effort moves none."""
        moved, positions = group.vehicle.moved, self.positions.numbers
        joints = group.joints[:, [one.joint for one in moved]]
        places = [one.place for one in moved]
        kinds = self.targets.numbers[group.targets[:, places]]
        targets = group.targets[:, [place + 1 for place in places]]
        numbers, now = self.targets.numbers[targets], positions[joints]
        most = np.array([one.velocity for one in moved]) * self._dt_s
        is_aimed = kinds == JointTargetKind.POSITION
        pace = np.minimum(most, self._find_paces(targets, np.where(is_aimed, numbers, np.nan), now))
        found = np.where(is_aimed, ramp_towards(now, numbers, pace), now)
        turned = now + np.clip(numbers * self._dt_s, -most, most)
        found = np.where(kinds == JointTargetKind.VELOCITY, turned, found)
        lower = np.minimum(now, [one.lower for one in moved])
        upper = np.maximum(now, [one.upper for one in moved])
        found = np.clip(found, lower, upper)
        self.velocities[joints] = (found - now) / self._dt_s
        positions[joints] = found

    def _find_paces(self, places: IntArray, aims: FloatArray, now: FloatArray) -> FloatArray:
        """Find ways (n, m) of a step; else joints would jump, then rest till the next command."""
        if self._period_steps == 1:
            return np.full(now.shape, np.inf)
        is_new = self._aims[places] != aims
        if is_new.any():
            paces = np.abs(aims - now) / self._period_steps * ROUNDING
            self._paces[places] = np.where(is_new, paces, self._paces[places])
            self._aims[places] = aims
        return self._paces[places]

    def _steer(self, group: VehicleGroup) -> None:
        """Advance the steering joints at their maximum speed."""
        vehicle, positions = group.vehicle, self.positions.numbers
        targets = self.targets.numbers[group.targets]
        steered = group.joints[:, list(vehicle.steered.joints)]
        most = np.array(vehicle.steering_rad_s) * self._dt_s
        angles = ramp_towards(positions[steered], targets[:, list(vehicle.steered.places)], most)
        self.velocities[steered] = (angles - positions[steered]) / self._dt_s
        by_speed = group.joints[:, list(vehicle.turned.joints)]
        self.velocities[by_speed] = targets[:, list(vehicle.turned.places)]

    def disc_motions(
        self, way: FloatArray, discs: RowSelection, own: RowSelection, unseen_s: float
    ) -> DiscMotions:
        """Make the motions of discs: those of `rows` move, the others stay near their last place.

        Args:
            way: (3, n) displacements of `rows`.
            discs: Rows of all d discs.
            own: Indices of `rows` among them.
            unseen_s: Time during which the others may move unseen.
        """
        table = self._table
        radius = table.radius[discs]
        ways, may_stop = np.zeros((len(radius), 2)), np.zeros(len(radius), np.bool_)
        dx, dy, turn = way
        if self._has_offset_discs:
            x, y = table.centre[:, self._at]
            arm = rotate_by_heading(x, y, table.headings(self._at))
            swung = rotate_by_heading(*arm, (np.cos(turn), np.sin(turn)))
            dx, dy = dx + swung[0] - arm[0], dy + swung[1] - arm[1]
        ways[own, 0], ways[own, 1] = dx, dy
        bend = table.pace[discs] * unseen_s
        chord = np.hypot(dx, dy)
        bend[own] = _bound_chord_deviation(chord, np.abs(turn))
        may_stop[own] = True
        reach = radius + bend + STOPPING_GAP_M
        reach[own] += chord
        return DiscMotions(table.discs(discs), ways, radius, bend, reach, may_stop)

    def commit(self, twists: FloatArray, way: FloatArray, fractions: FloatArray) -> None:
        """Move by fractions (n,) of displacements; robots that are stopped short stand still."""
        table, at = self._table, self._at
        held = np.flatnonzero(fractions < 1.0)
        if len(held):
            heading = table.headings(self.rows[held])
            way[:, held] = integrate_arcs(heading, twists[:, held], self._dt_s * fractions[held])
            twists[:, held] = 0.0
        table.place[0, at] += way[0]
        table.place[1, at] += way[1]
        table.turn_to(at, table.yaw[at] + way[2])
        table.twist[:, at] = twists
        self._roll_on(fractions, is_free=not len(held))

    def _roll_on(self, fractions: FloatArray, *, is_free: bool) -> None:
        at = 0
        for group in self._groups.values():
            count = len(group.rows)
            if count and group.vehicle.joint_count:
                self._roll_group(group, fractions[at : at + count, None], is_free=is_free)
            at += count

    def _roll_group(self, group: VehicleGroup, share: FloatArray, *, is_free: bool) -> None:
        vehicle = group.vehicle
        wheels = group.wheels
        rolled = self.velocities[wheels]
        if is_free:
            self.positions.numbers[wheels] += rolled * self._dt_s
        else:
            self.positions.numbers[wheels] += rolled * (self._dt_s * share)
            self.velocities[wheels] = rolled * (share >= 1.0)
        steering = group.joints[:, [*vehicle.steered.joints, *vehicle.turned.joints]]
        if steering.shape[1]:
            self.positions.numbers[steering] += self.velocities[steering] * self._dt_s
        for place, leader, ratio, offset in vehicle.following:
            own, leading = group.joints[:, place], group.joints[:, leader]
            self.positions.numbers[own] = ratio * self.positions.numbers[leading] + offset
            self.velocities[own] = ratio * self.velocities[leading]

    def _joints(self, row: int) -> slice:
        start = int(self._table.joint_start[row])
        return slice(start, start + int(self._table.joint_count[row]))


def _commanded_rim_speeds(
    vehicle: PlanarVehicle, targets: FloatArray, velocities: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Bound rim speeds (n,) [m/s] under targets, and find the changes (n,) that they demand."""
    if vehicle.twist >= 0:
        twist = targets[:, vehicle.twist : vehicle.twist + 3]
        return np.abs(twist).sum(axis=1), np.zeros(len(targets))
    driven = list(vehicle.driven.joints)
    radii = np.array([wheel.radius_m for wheel in vehicle.wheels[: len(driven)]])
    wanted = targets[:, list(vehicle.driven.places)] * radii
    now = velocities[:, driven] * radii
    fastest = np.maximum(np.abs(wanted), np.abs(now)).max(axis=1)
    return fastest, np.abs(wanted - now).max(axis=1)


def _bound_chord_deviation(chord: FloatArray, turn: FloatArray) -> FloatArray:
    """Bound the distance [m] of arcs from their chords; loosely beyond a rotation of 1 rad."""
    return np.where(turn < 1.0, chord * turn / 4.0, chord * (1.0 + turn))
