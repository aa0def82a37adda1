"""Rest of a model on level ground: its pose, its contacts with the ground and their static loads.

A load that several contacts can share in many ways is shared as if all yielded alike. Joints of
suspensions settle on their springs; other joints stay where they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from zensim.proto.messages.model_messages import MOVABLE_KINDS
from zensim.proto.se3 import FloatArray, from_origin, to_matrix
from zensim.sim_server.description.model_geometry import NO_MESHES, turns_freely
from zensim.sim_server.description.wheel_contacts import align_friction_to_axle, links_in_contact

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from zensim.proto.messages.model_messages import Joint, Model, Shape
    from zensim.sim_server.description.model_geometry import FindCorners

IntArray = npt.NDArray[np.intp]
BoolArray = npt.NDArray[np.bool_]

GRAVITY = 9.81
YIELD_M = 8.5e-6
"""How far one contact yields under the whole weight."""
RIM_POINTS = 8
"""Points of a cylinder that stands on its end."""
STANDING_COS = 0.9
"""Cosine of the tilt up to which a cylinder stands on its end."""
NEAR_GROUND = 0.3
"""Height, in widths of the model, up to which a point may come to touch the ground."""
MAX_TILT_RAD = 0.6
"""Tilt beyond which a model counts as tipped over."""
MAX_SETTLING_STEPS = 60
MAX_STEP = 0.05
"""Length of a settling step [m, rad]."""
LEAST_LEVER_M = 1e-4
"""Distance from its joint below which a point only rolls."""
LEAST_SHARE = 1e-6
"""Least share of a step that is shortened until it descends."""
SETTLED = 1e-9
"""Step [m, rad] below which a model is at rest."""
LEVEL_AXIS_Z = 0.5
"""Axes with a lesser z count as level."""
UPRIGHT_AXIS_Z = 0.9
"""Axes with a greater z count as upright."""
MIN_LOAD_SHARE = 1e-6
"""Share of the weight; contacts with less are not in contact."""
PointOfShape = tuple[FloatArray, float, float]
"""Centre in the shape, radius of the circle, radius of the ball."""
BOX_CORNERS = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
MAX_MESH_POINTS = 64


@dataclass(frozen=True)
class SupportPoints:
    """Points n of the collision shapes that may touch the ground, in their links.

    A point is the lowest of a ball of radius `ball` about the lowest point of a circle of radius
    `rim` about `centre`, normal to `axis`.

    Attributes:
        link: (n,) index among `Model.links`.
        shape: (n,) index in `shapes`.
    """

    link: IntArray
    centre: FloatArray
    axis: FloatArray
    rim: FloatArray
    ball: FloatArray
    shape: IntArray
    shapes: tuple[Shape, ...]

    def select(self, keep: BoolArray) -> SupportPoints:
        """Select some points."""
        return SupportPoints(
            self.link[keep],
            self.centre[keep],
            self.axis[keep],
            self.rim[keep],
            self.ball[keep],
            self.shape[keep],
            self.shapes,
        )


@dataclass(frozen=True)
class LinkFrames:
    """Frames of links in the frame of the ground: matrices (n, 3, 3) and origins (n, 3)."""

    turn: FloatArray
    place: FloatArray

    def points(self, link: IntArray, point: FloatArray) -> FloatArray:
        """Express points (m, 3) of links (m,) in the frame of the ground."""
        return self.directions(link, point) + self.place[link]

    def directions(self, link: IntArray, direction: FloatArray) -> FloatArray:
        """Express directions (m, 3) of links (m,) in the frame of the ground."""
        found: FloatArray = (self.turn[link] @ direction[:, :, None])[:, :, 0]
        return found

    def tilted(self, turn: FloatArray, centre: FloatArray, lift: float) -> LinkFrames:
        """Turn all links about a point, then lift them."""
        place = (self.place - centre) @ turn.T + centre
        return LinkFrames(turn @ self.turn, place + np.array([0.0, 0.0, lift]))


class LinkTree:
    """Joints of a model as arrays: forward kinematics of one pose."""

    def __init__(self, model: Model) -> None:
        index = {link.name: i for i, link in enumerate(model.links)}
        self.joints = model.joints
        self.parents = [index[joint.parent] for joint in model.joints]
        origins = np.array([from_origin(joint.origin) for joint in model.joints]).reshape(-1, 7)
        self._places = origins[:, :3]
        self._turns = to_matrix(origins[:, 3:])

    def frames(self, positions: FloatArray) -> LinkFrames:
        """Find the frames of all links, the root at the origin."""
        count = len(self.joints) + 1
        turn, place = np.empty((count, 3, 3)), np.zeros((count, 3))
        turn[0] = np.eye(3)
        for i, parent in enumerate(self.parents):
            place[i + 1] = place[parent] + turn[parent] @ self._places[i]
            turn[i + 1] = turn[parent] @ self._turns[i]
            if position := float(positions[i]):
                axis = np.array(self.joints[i].axis)
                if self.joints[i].kind == "prismatic":
                    place[i + 1] += turn[i + 1] @ axis * position
                else:
                    turn[i + 1] = turn[i + 1] @ find_rotation(axis * position)
        return LinkFrames(turn, place)

    def ancestors(self, link: int) -> Iterator[int]:
        """List the joints from a link up to the root."""
        while link:
            yield link - 1
            link = self.parents[link - 1]


def find_rotation(vector: FloatArray) -> FloatArray:
    """Find the matrix of a rotation vector [rad]. Source: Rodrigues' formula."""
    angle = float(np.sqrt(vector @ vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = (vector / angle).tolist()
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    found: FloatArray = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
    return found


@dataclass(frozen=True)
class RestPose:
    """A model at rest on level ground.

    Attributes:
        frames: Of its links, the root upright as far as the model is.
        positions: Of its joints.
        support: The points in contact.
        points: (n, 3) where they touch the ground.
        loads: (n,) [N].
        clearances: Height [m] of the lowest point of links near the ground, by index.
        tilt_rad: Of the root link.
        is_stable: Whether it came to rest without tipping over.
    """

    frames: LinkFrames
    positions: FloatArray
    support: SupportPoints
    points: FloatArray
    loads: FloatArray
    clearances: dict[int, float]
    tilt_rad: float
    is_stable: bool


class RestSolver:
    """Finds how a model rests, for any positions of its joints.

    Args:
        model: The robot.
        corners: Needed for meshes.
    """

    def __init__(self, model: Model, corners: FindCorners = NO_MESHES) -> None:
        self.model = model
        self.tree = LinkTree(model)
        at_zero = self.tree.frames(np.zeros(len(model.joints)))
        self._support = _keep_low(_list_support_points(model, corners, at_zero), at_zero)
        inertials = [link.inertial for link in model.links]
        weights = [one.inertial.mass_kg - one.weightless.mass_kg for one in model.links]
        self.weight_n = GRAVITY * sum(weights)
        self._forces = GRAVITY * np.array(weights)
        self._com = np.array([one.com_in_link for one in inertials])
        self._all_links = np.arange(len(model.links))
        self.free = _list_free_joints(model, self.tree, self._support, at_zero)
        self._stiffness = _find_stiffness(self._support, self.weight_n)
        self._moved = _find_moved_links(self.tree, self.free)

    def solve(self, positions: FloatArray) -> RestPose:
        """Find the rest pose with joints at these positions, those of suspensions excepted."""
        positions = positions.astype(np.float64)
        if not len(self._support.link) or self.weight_n <= 0.0:
            return self._make_rest(self.tree.frames(positions), positions, is_stable=False)
        tilt, frames, is_settled = np.eye(3), self.tree.frames(positions), False
        lift = -float(self._touch(frames)[0].min())
        frames = frames.tilted(tilt, np.zeros(3), lift)
        for _ in range(MAX_SETTLING_STEPS):
            centre = self._forces @ frames.points(self._all_links, self._com) / self.weight_n
            step = self._find_step(frames, positions, centre)
            size = float(np.abs(step).max())
            step *= min(1.0, MAX_STEP / max(size, MAX_STEP))
            turn = find_rotation(np.array([step[1], step[2], 0.0]))
            tilt = turn @ tilt
            if self.free:
                positions[self.free] += step[3:]
                root = frames.place[0]
                frames = self.tree.frames(positions).tilted(tilt @ turn.T, np.zeros(3), 0.0)
                frames = LinkFrames(frames.turn, frames.place + root)
            frames = frames.tilted(turn, centre, float(step[0]))
            if tilt[2, 2] < np.cos(MAX_TILT_RAD):
                break
            if size < SETTLED:
                is_settled = True
                break
        return self._make_rest(frames, positions, is_stable=is_settled)

    def _touch(self, frames: LinkFrames) -> tuple[FloatArray, FloatArray]:
        """Find heights (n,) and places (n, 3) of the lowest points."""
        support = self._support
        points = frames.points(support.link, support.centre)
        axes = frames.directions(support.link, support.axis)
        lean = np.sqrt(np.maximum(1.0 - axes[:, 2] ** 2, 1e-12))
        down = axes * axes[:, 2:3]
        down[:, 2] -= 1.0
        points = points + down * (support.rim / lean)[:, None]
        points[:, 2] -= support.ball
        return points[:, 2], points

    def _find_step(
        self, frames: LinkFrames, positions: FloatArray, centre: FloatArray
    ) -> FloatArray:
        """Find the change of height, roll, pitch and free joints towards rest."""
        heights, points = self._touch(frames)
        rows = self._jacobian(frames, self._support.link, points, centre)
        masses = frames.points(self._all_links, self._com)
        pull = self._forces @ self._jacobian(frames, self._all_links, masses, centre)
        matrix = np.diag(np.full(rows.shape[1], 1e-9 * float(self._stiffness.max())))
        matrix[1, 1] *= max(np.ptp(points[:, 0]), np.ptp(points[:, 1])) ** 2 + 1e-6
        matrix[2, 2] = matrix[1, 1]
        for at, joint in enumerate(self.free, start=3):
            stiffness, force = _find_joint_force(
                self.tree.joints[joint], float(positions[joint]), float(self._stiffness.max())
            )
            matrix[at, at] += stiffness
            pull[at] += force
        return _settle(matrix, pull, rows, heights, self._stiffness)

    def _jacobian(
        self, frames: LinkFrames, links: IntArray, points: FloatArray, centre: FloatArray
    ) -> FloatArray:
        """Find the derivatives (n, 3 + free joints) of heights of points of links."""
        arms = points - centre
        rows = np.ones((len(points), 3 + len(self.free)))
        rows[:, 1], rows[:, 2] = arms[:, 1], -arms[:, 0]
        for at, joint in enumerate(self.free, start=3):
            one = self.tree.joints[joint]
            axis = frames.turn[joint + 1] @ np.array(one.axis)
            if one.kind == "prismatic":
                rows[:, at] = axis[2]
            else:
                arm = points - frames.place[joint + 1]
                rows[:, at] = axis[0] * arm[:, 1] - axis[1] * arm[:, 0]
            rows[:, at] *= self._moved[at - 3][links]
        return rows

    def _make_rest(self, frames: LinkFrames, positions: FloatArray, *, is_stable: bool) -> RestPose:
        heights, points = self._touch(frames)
        loads = self._stiffness * np.maximum(-heights, 0.0)
        bears = loads > MIN_LOAD_SHARE * max(self.weight_n, 1e-12)
        links = self._support.link
        lowest = {link: float(heights[links == link].min()) for link in set(links.tolist())}
        return RestPose(
            frames,
            positions,
            self._support.select(bears),
            points[bears],
            loads[bears],
            lowest,
            tilt_rad=float(np.arccos(np.clip(frames.turn[0, 2, 2], -1.0, 1.0))),
            is_stable=is_stable,
        )


def _settle(
    matrix: FloatArray,
    pull: FloatArray,
    rows: FloatArray,
    heights: FloatArray,
    stiffness: FloatArray,
) -> FloatArray:
    """Minimise pull x + x' matrix x / 2 + sum of stiffness max(0, -(height + row x))^2 / 2."""
    step = np.zeros(len(pull))
    touches = heights <= float(heights.min()) + 1e-12

    def energy(x: FloatArray) -> float:
        depth = np.minimum(heights + rows @ x, 0.0)
        return float(pull @ x + x @ matrix @ x / 2.0 + stiffness @ depth**2 / 2.0)

    for _ in range(40):
        active, hard = rows[touches], stiffness[touches]
        whole = matrix + active.T @ (active * hard[:, None])
        wanted = np.linalg.solve(whole, -pull - active.T @ (hard * heights[touches]))
        now, share = energy(step), 1.0
        while energy(step + share * (wanted - step)) > now and share > LEAST_SHARE:
            share /= 2.0
        step = step + share * (wanted - step)
        before, touches = touches, heights + rows @ step < 0.0
        if share == 1.0 and (before == touches).all():
            break
        if not touches.any():
            touches = before
            break
    return step


def _find_joint_force(joint: Joint, position: float, hardest: float) -> tuple[float, float]:
    """Find stiffness and force of a joint by its spring and its limits."""
    stiffness = joint.spring_stiffness
    force = stiffness * (position - joint.spring_reference)
    if joint.kind != "continuous" and joint.lower <= joint.upper:
        beyond = position - min(max(position, joint.lower), joint.upper)
        if beyond:
            return stiffness + hardest, force + hardest * beyond
    return stiffness, force


def _list_support_points(model: Model, corners: FindCorners, frames: LinkFrames) -> SupportPoints:
    shapes: list[Shape] = []
    rows: list[tuple[int, FloatArray, FloatArray, float, float, int]] = []
    axles = (None, *model.joints)
    for link, one in enumerate(links_in_contact(model, corners)):
        for shape in align_friction_to_axle(one, axles[link]).collisions:
            if shape.kind == "plane":
                continue
            pose = from_origin(shape.origin)
            turn = to_matrix(pose[3:])
            up = turn.T @ frames.turn[link].T @ np.array([0.0, 0.0, 1.0])
            for centre, rim, ball in _list_points_of_shape(shape, up, corners):
                axis = turn[:, 2] if rim else np.zeros(3)
                rows.append((link, pose[:3] + turn @ centre, axis, rim, ball, len(shapes)))
            shapes.append(shape)
    return SupportPoints(
        np.array([row[0] for row in rows], dtype=np.intp),
        np.array([row[1] for row in rows]).reshape(-1, 3),
        np.array([row[2] for row in rows]).reshape(-1, 3),
        np.array([row[3] for row in rows]),
        np.array([row[4] for row in rows]),
        np.array([row[5] for row in rows], dtype=np.intp),
        tuple(shapes),
    )


def _list_points_of_shape(
    shape: Shape, up: FloatArray, corners: FindCorners
) -> Iterable[PointOfShape]:
    """List the support points of a shape; `up` is the vertical in the shape."""
    if shape.kind == "sphere":
        return [(np.zeros(3), 0.0, shape.size[0])]
    if shape.kind == "box":
        return [(corner, 0.0, 0.0) for corner in BOX_CORNERS * shape.size]
    if shape.kind == "mesh":
        points = np.unique(corners(shape.mesh).astype(np.float64) * shape.size, axis=0)
        return [(point, 0.0, 0.0) for point in _lowest_points(points, up)]
    radius, length, _ = shape.size
    ends = [np.array([0.0, 0.0, end]) for end in (-length / 2.0, length / 2.0)]
    if shape.kind == "capsule":
        return [(end, 0.0, radius) for end in ends]
    if abs(up[2]) < STANDING_COS:
        return [(end, radius, 0.0) for end in ends]
    angles = np.arange(RIM_POINTS) * (2.0 * np.pi / RIM_POINTS)
    rim = np.stack([radius * np.cos(angles), radius * np.sin(angles), 0.0 * angles], axis=1)
    return [(point, 0.0, 0.0) for end in ends for point in rim + end]


def _lowest_points(points: FloatArray, up: FloatArray) -> FloatArray:
    """Select the outermost of the low points of a mesh."""
    heights = points @ up
    reach = float(np.ptp(points, axis=0).max())
    low: FloatArray = points[heights <= heights.min() + 0.1 * reach]
    if len(low) <= MAX_MESH_POINTS:
        return low
    aside = np.cross(up, [1.0, 0.0, 0.0] if abs(up[0]) < LEVEL_AXIS_Z else [0.0, 1.0, 0.0])
    ahead = np.cross(aside, up)
    angles = np.arange(MAX_MESH_POINTS // 4) * (8.0 * np.pi / MAX_MESH_POINTS)
    level = np.outer(np.cos(angles), ahead) + np.outer(np.sin(angles), aside)
    # Straight down, and leaning a little to each side.
    directions = np.concatenate([level * lean - up for lean in (0.0, 0.03, 0.3, 1.0)])
    outermost: FloatArray = low[np.unique((low @ directions.T).argmax(axis=0))]
    return outermost


def _keep_low(support: SupportPoints, frames: LinkFrames) -> SupportPoints:
    if not len(support.link):
        return support
    points = frames.points(support.link, support.centre)
    heights = points[:, 2] - support.rim - support.ball
    width = float(max(np.ptp(points[:, 0]), np.ptp(points[:, 1])))
    return support.select(heights <= heights.min() + NEAR_GROUND * width + 0.02)


def _find_stiffness(support: SupportPoints, weight_n: float) -> FloatArray:
    rigid = max(weight_n, 1e-9) / YIELD_M
    soft = [shape.contact.stiffness for shape in support.shapes]
    known = np.array([min(own, rigid) if own > 0.0 else rigid for own in soft])
    return known[support.shape] if len(support.shape) else np.zeros(0)


def _list_free_joints(
    model: Model, tree: LinkTree, support: SupportPoints, frames: LinkFrames
) -> list[int]:
    """List the joints of suspensions: nothing drives or holds them, and they carry supports."""
    driven = {actuator.joint for actuator in model.drive_actuators}
    held = {name for one in model.joint_controllers if one.holds for name in one.joints}
    carrying = {joint for link in set(support.link.tolist()) for joint in tree.ancestors(link)}
    leaves = {i for i in range(len(model.joints)) if i + 1 not in tree.parents}
    found = []
    for i in sorted(carrying):
        joint = model.joints[i]
        if joint.kind not in MOVABLE_KINDS or joint.mimic is not None:
            continue
        if joint.name in driven or joint.name in held:
            continue
        if joint.kind != "prismatic" and is_upright(axis_of(frames, joint, i)):
            continue
        is_wheel = turns_freely(joint) and i in leaves
        if joint.spring_stiffness or not (is_wheel or _is_rolling(tree, support, frames, i)):
            found.append(i)
    return found


def _is_rolling(tree: LinkTree, support: SupportPoints, frames: LinkFrames, joint: int) -> bool:
    """Whether a joint only rolls what it carries: no support point rises when it turns."""
    if tree.joints[joint].kind == "prismatic":
        return False
    carried = [joint in tree.ancestors(link) for link in support.link.tolist()]
    arms = frames.points(support.link, support.centre)[carried] - frames.place[joint + 1]
    axis = axis_of(frames, tree.joints[joint], joint)
    rises = axis[0] * arms[:, 1] - axis[1] * arms[:, 0]
    return bool(np.abs(rises).max() < LEAST_LEVER_M)


def axis_of(frames: LinkFrames, joint: Joint, index: int) -> FloatArray:
    """Find the axis of a joint in the frame of the ground."""
    found: FloatArray = frames.turn[index + 1] @ np.array(joint.axis)
    return found


def is_upright(axis: FloatArray) -> bool:
    """Whether an axis points up or down."""
    return abs(float(axis[2])) > UPRIGHT_AXIS_Z


def _find_moved_links(tree: LinkTree, free: Sequence[int]) -> list[FloatArray]:
    links = range(len(tree.joints) + 1)
    return [
        np.array([float(joint in tuple(tree.ancestors(link))) for link in links]) for joint in free
    ]
