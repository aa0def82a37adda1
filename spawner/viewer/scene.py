"""What the page shows: models and a snapshot to poses, form by form. NumPy only."""

from typing import Final

import msgspec
import numpy as np

from zensim.proto.messages.agent_messages import STATE_COLUMNS
from zensim.proto.messages.telemetry_messages import EntityModel, GetModelsResponse, Snapshot
from zensim.proto.messages.world_messages import Scene
from zensim.proto.rotation import to_yaw
from zensim.spawner.viewer.form import Form, NotATree, form_of
from zensim.spawner.viewer.kinematics import Array, Poses, link_poses
from zensim.spawner.viewer.triangles import NO_MESHES, Meshes

VIEW_AZIMUTH_RAD: Final = np.radians(20.0)
"""How far the view is turned from the long side of the fleet: a row then runs into the depth."""
VIEW_ELEVATION_RAD: Final = np.radians(17.0)
VIEW_MARGIN_M: Final = 0.2
"""Around the outermost robots."""


class UnknownEntity(Exception):
    """A snapshot names an entity whose model is not known yet."""


class MismatchedSnapshot(Exception):
    """A snapshot's arrays do not fit its names and their models."""


class Cohort(msgspec.Struct, frozen=True, eq=False):
    """The entities that share one form."""

    form: Form
    names: tuple[str, ...]
    rows: np.ndarray
    """(k,), rows of `Snapshot.base`."""
    joint_columns: np.ndarray
    """(k, joints), indices into `Snapshot.joint_positions`."""


class Fleet(msgspec.Struct, frozen=True, eq=False):
    """Everybody in the world, form by form."""

    names: tuple[str, ...] = ()
    cohorts: tuple[Cohort, ...] = ()
    members: dict[str, EntityModel] = {}
    forms: dict[str, Form] = {}
    robots: tuple[str, ...] = ()
    """The entities that have a drive."""
    rows: dict[str, int] = {}
    """Where an entity is in `Frame.base`."""
    joints: int = 0
    """Of all entities."""
    meshes: Meshes = NO_MESHES
    """Those that forms name."""
    scene: Scene = Scene()


class Frame(msgspec.Struct, frozen=True, eq=False):
    """One snapshot, ready to be drawn."""

    base: Array = msgspec.field(default_factory=lambda: np.zeros((0, STATE_COLUMNS)))
    """(n, STATE_COLUMNS), in the order of `Fleet.names`."""
    links: tuple[tuple[Poses, ...], ...] = ()
    """Poses of every link of every cohort."""


class Status(msgspec.Struct, frozen=True):
    """The simulation in one line."""

    state: str = "no server"
    sim_time_s: float = 0.0
    real_time_factor: float = 0.0
    robots: int = 0
    entities: int = 0


class LastCommand(msgspec.Struct, frozen=True):
    """What a robot was told last."""

    forward_mps: float
    turn_radps: float
    age_s: float


def arrange(names: tuple[str, ...], models: GetModelsResponse, meshes: Meshes = NO_MESHES) -> Fleet:
    """Sort entities by what they look like.

    Args:
        names: Of a snapshot.
        models: Of all of them.
        meshes: Those that are here, by sha256.

    Raises:
        UnknownEntity: A name has no model.
        MismatchedSnapshot: A model is not one.
    """
    members = {member.entity: member for member in models.entities}
    try:
        forms = [form_of(model, meshes) for model in models.models]
        forms_by_name = {name: forms[members[name].model] for name in names}
    except (KeyError, IndexError) as error:
        raise UnknownEntity(f"no model of {error}") from error
    except NotATree as error:
        raise MismatchedSnapshot(str(error)) from error
    counts = [len(form.hinges) for form in forms_by_name.values()]
    starts = np.cumsum([0, *counts])
    rows: dict[Form, list[int]] = {}
    for row, form in enumerate(forms_by_name.values()):
        rows.setdefault(form, []).append(row)
    return Fleet(
        names=names,
        cohorts=tuple(_cohort(form, names, np.array(of), starts) for form, of in rows.items()),
        members=members,
        forms=forms_by_name,
        robots=tuple(n for n in names if models.models[members[n].model].drive is not None),
        rows={name: row for row, name in enumerate(names)},
        joints=int(starts[-1]),
        meshes=meshes,
        scene=models.scene,
    )


def draw(fleet: Fleet, snapshot: Snapshot) -> Frame:
    """Find where every link is.

    Raises:
        MismatchedSnapshot: Too few or too many numbers, or one that is not finite.
    """
    base = _numbers(snapshot.base, len(fleet.names) * STATE_COLUMNS, "base")
    joints = _numbers(snapshot.joint_positions, fleet.joints, "joint_positions")
    states = base.reshape(-1, STATE_COLUMNS)
    links = tuple(
        tuple(link_poses(c.form.hinges, states[c.rows, :7], joints[c.joint_columns]))
        for c in fleet.cohorts
    )
    return Frame(states, links)


def framing(points: Array, *, aspect: float, fov_rad: float) -> tuple[Array, Array]:
    """Find a camera position and the point that it looks at, so that all points are in view.

    Args:
        points: (n, 3) in the world frame; n > 0.
        aspect: Width over height of the picture.
        fov_rad: Vertical field of view.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    centre = (low + high) / 2.0
    right, up, ahead = _view_axes(high - low)
    offsets = np.stack([points - centre + corner for corner in _corners(VIEW_MARGIN_M)])
    half_height = np.tan(fov_rad / 2.0)
    distances = np.maximum(
        np.abs(offsets @ up) / half_height, np.abs(offsets @ right) / (half_height * aspect)
    )
    return centre - ahead * float(np.max(distances - offsets @ ahead)), centre


def pose_lines(state: Array) -> tuple[str, str]:
    """Write a base state (STATE_COLUMNS,) as position and heading, and as speed."""
    x, y, z = state[:3]
    yaw = np.degrees(to_yaw(state[3:7]))
    speed, turn = np.linalg.norm(state[7:9]), state[12]
    return (
        f"x {x:.2f}  y {y:.2f}  z {z:.2f} m  yaw {yaw:.0f}°",
        f"{speed:.2f} m/s  {turn:.2f} rad/s",
    )


def _cohort(form: Form, names: tuple[str, ...], rows: np.ndarray, starts: np.ndarray) -> Cohort:
    columns = starts[rows][:, None] + np.arange(len(form.hinges))
    return Cohort(form, tuple(names[row] for row in rows), rows, columns)


def _numbers(payload: bytes, count: int, what: str) -> Array:
    if len(payload) != 8 * count:
        raise MismatchedSnapshot(f"{what} is {len(payload)} bytes; its models ask for {8 * count}")
    numbers = np.frombuffer(payload, dtype="<f8")
    if not np.isfinite(numbers).all():
        raise MismatchedSnapshot(f"{what} holds a number that is not finite")
    return numbers


def _view_axes(extent: Array) -> tuple[Array, Array, Array]:
    """Right, up and ahead of a camera that looks along the long side, from above."""
    azimuth = VIEW_AZIMUTH_RAD if extent[0] >= extent[1] else np.pi / 2.0 - VIEW_AZIMUTH_RAD
    flat = np.cos(VIEW_ELEVATION_RAD)
    ahead = np.array((flat * np.cos(azimuth), flat * np.sin(azimuth), -np.sin(VIEW_ELEVATION_RAD)))
    right = np.array((np.sin(azimuth), -np.cos(azimuth), 0.0))
    return right, np.cross(right, ahead), ahead


def _corners(half: float) -> Array:
    return half * np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
