"""Who hardly moves: judged by how far it came in a second, since slow motion is motion too."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from zensim.proto.messages.model_messages import Decay, Inertial, Model
from zensim.sim_server.physics.actuation import actuation_of
from zensim.sim_server.physics.engine import FloatArray, Reading

IntArray = npt.NDArray[np.intp]
BoolArray = npt.NDArray[np.bool_]

CALM_S = 1.0
"""For how long a body must hardly move."""
SPARE_MPS = 1.0
"""What may come to the speed of an awake body until the next look."""
GAP_M = 0.02
CHUNK = 256
"""Awake bodies whose distances from all others are found at once."""


class State(IntEnum):
    """What a body does, as far as sleep goes."""

    UNKNOWN = 0
    FIXED = 1
    """Never moves, and wakes nobody."""
    RESTLESS = 2
    """Never sleeps."""
    AWAKE = 3
    ASLEEP = 4


@dataclass(frozen=True)
class Bounds:
    """What a body may do in `CALM_S` and still be calm: metres, radians, and of its joints."""

    moved_m: float
    turned_rad: float
    joint: float


LOOSE = Bounds(5e-4, 1e-3, 1e-3)
BRAKED = Bounds(3e-3, 0.015, 0.1)
"""Of robots whose motors hold wheels: what a finite solver leaves lets those creep by 1-2 mm/s."""


def bounds_of(model: Model) -> Bounds:
    """Find by what a model is judged."""
    return BRAKED if actuation_of(model).speeds.joints else LOOSE


def first_state(model: Model) -> State:
    """Say whether bodies of a model may sleep.

    Those do not that something acts on in every step: loads, gears, a twist of their own.
    """
    if model.is_static:
        can_move = any(joint.kind != "fixed" for joint in model.joints)
        return State.RESTLESS if can_move else State.FIXED
    is_loaded = any(link.weightless != Inertial() or link.decay != Decay() for link in model.links)
    is_geared = any(joint.mimic is not None for joint in model.joints)
    is_imposed = actuation_of(model).twist is not None
    return State.RESTLESS if is_loaded or is_geared or is_imposed else State.AWAKE


class Calm:
    """Bodies by number: where each was when it last moved, or where it sleeps."""

    def __init__(self, calm_steps: int) -> None:
        self._calm_steps = calm_steps
        self.state = np.zeros(64, dtype=np.int8)
        self.is_driven = np.zeros(64, dtype=np.bool_)
        self.radius: FloatArray = np.zeros(64)
        self.base: FloatArray = np.full((64, 13), np.nan)
        self.joints: FloatArray = np.zeros((64, 4))
        self.joint_count = np.zeros(64, dtype=np.intp)
        self._since = np.zeros(64, dtype=np.int64)
        self._bounds: FloatArray = np.zeros((64, 3))

    def take(self, body: int, model: Model, radius_m: float, step: int) -> None:
        """Take a new body in."""
        self._make_room(body, len(model.joints))
        bounds = bounds_of(model)
        self.state[body] = first_state(model)
        self.radius[body] = radius_m
        self.joint_count[body] = len(model.joints)
        self._bounds[body] = bounds.moved_m, bounds.turned_rad, bounds.joint
        self.is_driven[body] = False
        self.stir(body, step)

    def stir(self, body: int | IntArray, step: int) -> None:
        """Note that a body may move from now on, perhaps from another place."""
        self.base[body] = np.nan
        self._since[body] = step

    def drop(self, body: int) -> None:
        """Forget a body."""
        self.state[body] = State.UNKNOWN

    def having(self, *states: State) -> BoolArray:
        """Find the bodies that are in one of some states."""
        return np.asarray(np.isin(self.state, states))

    def compare(self, bodies: IntArray, reading: Reading, step: int) -> BoolArray:
        """See how far bodies came, and say which have been calm for long enough."""
        positions = self._grid(bodies, reading.joint_positions)
        before = self.base[bodies]
        moved, turned, bent = self._bounds[bodies].T
        with np.errstate(all="ignore"):  # of bodies gone bad
            away = np.linalg.norm(reading.base[:, :3] - before[:, :3], axis=1)
            # Of the half turn between two quaternions, whichever sign they have.
            cosines = np.abs((reading.base[:, 3:7] * before[:, 3:7]).sum(axis=1))
            is_calm = (away <= moved) & (cosines >= np.cos(turned / 2.0))
        swung = np.abs(positions - self.joints[bodies]).max(axis=1, initial=0.0)
        is_calm &= swung <= bent
        stirred = bodies[~is_calm]
        self.base[stirred] = reading.base[~is_calm]
        self.joints[stirred] = positions[~is_calm]
        self._since[stirred] = step
        return np.asarray(step - self._since[bodies] >= self._calm_steps)

    def lay_down(self, bodies: IntArray, reading: Reading) -> None:
        """Keep the state in which bodies fall asleep: at rest."""
        self.state[bodies] = State.ASLEEP
        self.base[bodies] = reading.base
        self.base[bodies, 7:] = 0.0
        self.joints[bodies] = self._grid(bodies, reading.joint_positions)

    def joints_of(self, bodies: IntArray) -> FloatArray:
        """List the joint positions of sleepers, body by body."""
        return np.asarray(self.joints[bodies][self._mask(bodies)])

    def _grid(self, bodies: IntArray, numbers: FloatArray) -> FloatArray:
        found = np.zeros((len(bodies), self.joints.shape[1]))
        found[self._mask(bodies)] = numbers
        return found

    def _mask(self, bodies: IntArray) -> BoolArray:
        columns = np.arange(self.joints.shape[1])
        return np.asarray(columns < self.joint_count[bodies][:, None])

    def _make_room(self, body: int, joints: int) -> None:
        height, width = len(self.state), self.joints.shape[1]
        if joints > width:
            self.joints = np.pad(self.joints, ((0, 0), (0, joints - width)))
        if body < height:
            return
        more = max(height, body + 1 - height)
        for name in ("state", "is_driven", "radius", "joint_count", "_since"):
            setattr(self, name, np.pad(getattr(self, name), (0, more)))
        for name in ("base", "joints", "_bounds"):
            setattr(self, name, np.pad(getattr(self, name), ((0, more), (0, 0))))


def reached(
    base: FloatArray, radius: FloatArray, others: FloatArray, radii: FloatArray, ahead_s: float
) -> BoolArray:
    """Find the others that bodies may touch soon.

    Args:
        base: (n, 13) of the bodies.
        radius: (n,) of balls that hold them.
        others: (m, 3) where the others are.
        radii: (m,) of balls that hold them.
        ahead_s: How soon.

    Returns:
        (m,) whether any may.
    """
    found = np.zeros(len(others), dtype=np.bool_)
    with np.errstate(all="ignore"):  # of bodies gone bad
        spins = radius * np.linalg.norm(base[:, 10:], axis=1)
        speeds = np.linalg.norm(base[:, 7:10], axis=1) + spins
        reach = radius + GAP_M + (speeds + SPARE_MPS) * ahead_s
        for start in range(0, len(base), CHUNK):
            some = slice(start, start + CHUNK)
            apart = np.linalg.norm(base[some, None, :3] - others[None], axis=2)
            found |= (apart < reach[some, None] + radii[None]).any(axis=0)
    return found
