"""Solves a step of MuJoCo: once, or again while contacts slide otherwise than assumed."""

from collections.abc import Callable, Sequence
from itertools import accumulate
from typing import NamedTuple

import mujoco
import numpy as np
import numpy.typing as npt

from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.mujoco.compiled_model import CompiledModel
from zensim.sim_server.physics.mujoco.mujoco_contact import (
    FrictionRows,
    LiftIteration,
    MjRows,
    find_sliding_rows,
    is_deep,
    limit_penetration_recovery,
    may_slide,
    predict_lifts,
)

MAX_SPEED_CHANGE = 20.0
"""Change of a speed in a step [m/s or rad/s] above which the step is solved again."""
MAX_SOLVES = 4
"""Solves of a step in which contacts slide."""

SolveAgain = Callable[[int, tuple[FloatArray, FloatArray], FloatArray], None]


class StackedContacts(NamedTuple):
    """Rows of the contacts of several worlds, one after another; see `MjRows`."""

    dim: npt.NDArray[np.int32]
    efc_address: npt.NDArray[np.int32]
    friction: FloatArray


def find_solved_dofs(
    change: FloatArray, islands: npt.NDArray[np.int32], trees: npt.NDArray[np.int32]
) -> npt.NDArray[np.bool_]:
    """Find the degrees of freedom that have nothing to do with those of too large a change.

    Args:
        change: (n,) of their speeds in a step.
        islands: (n,) of constraints that affect each other; -1 = unconstrained.
        trees: (n,) of links that joints connect.

    Returns:
        (n,) mask.
    """
    is_failed = ~(np.abs(change) <= MAX_SPEED_CHANGE)
    in_failed_island = np.isin(islands, np.unique(islands[is_failed & (islands >= 0)]))
    return ~(in_failed_island | np.isin(trees, np.unique(trees[is_failed])))


class StepSolver:
    """Solves and integrates a step of worlds of one model, each with the bits that it has alone.

    What is computed between two calls of MuJoCo is computed for all of them at once: arrays of rows
    have those of one world after another.

    Attributes:
        suspects: Worlds that changed a speed too much: the states of the others are finite.
    """

    def __init__(
        self,
        compiled: CompiledModel,
        model: mujoco.MjModel,
        states: Sequence[mujoco.MjData],
        solve_again: SolveAgain,
    ) -> None:
        """Take worlds whose constraints are made.

        Args:
            compiled: Of all.
            model: Copy of its model, for all.
            states: Of the worlds.
            solve_again: Solves otherwise, from qpos and qvel before, what changed too much.
        """
        self.suspects: set[int] = set()
        self._model, self._states, self._solve_again = model, states, solve_again
        self._dt_s, self._most_friction = compiled.dt_s, compiled.most_friction
        # qpos and qvel before, to start again.
        self._positions = [data.qpos.copy() for data in states]
        self._velocities = [data.qvel.copy() for data in states]

    def solve(self) -> None:
        """Solve and integrate; again while contacts slide otherwise than assumed."""
        depths, of_contacts, predicted = [], [], []
        for data, now in zip(self._states, self._velocities, strict=True):
            first = data.ne + data.nf + data.nl
            # Predicted: friction stops what a step of a curve adds to the velocity of a wheel.
            own = np.empty(data.nefc)
            mujoco.mj_mulJacVec(self._model, data, own, now + self._dt_s * data.qacc)
            predicted.append(own)
            # Rows of contacts, which lie side by side: contacts lie apart in memory.
            of_contacts.append(own[first:])
            depths.append(data.efc_pos[first:])
        if is_deep(_join(depths), self._dt_s):
            for data in self._states:
                limit_penetration_recovery(data.efc_aref, data.contact, data.efc_KBIP, self._dt_s)
        rows = None
        if may_slide(_join(of_contacts), self._most_friction):
            velocities = _join(predicted)
            rows = find_sliding_rows(self._stack_contacts(), velocities)
        if rows is None:
            self._advance(range(len(self._states)))
        else:
            self._solve_sliding(rows, velocities)

    def _solve_sliding(self, rows: FrictionRows, velocities: FloatArray) -> None:
        """Solve until the lifts of contacts agree with their slips."""
        starts = list(accumulate((data.nefc for data in self._states), initial=0))
        owners = np.searchsorted(starts, rows.normals, side="right") - 1
        active = sorted(set(owners.tolist()))
        self._advance([one for one in range(len(self._states)) if one not in active])
        lifts = predict_lifts(rows, _join([data.efc_vel for data in self._states]), velocities)
        wanted = _join([data.efc_aref for data in self._states])
        iteration = LiftIteration(rows, wanted, lifts, self._dt_s)
        for _ in range(MAX_SOLVES - 1):
            self._correct(iteration, wanted, starts, active)
            for one in active:
                own = velocities[starts[one] : starts[one + 1]]
                mujoco.mj_mulJacVec(self._model, self._states[one], own, self._states[one].qvel)
            if not (is_off := iteration.refine(velocities)).any():
                return
            if len(left := sorted(set(owners[is_off].tolist()))) < len(active):
                active, kept = left, np.isin(owners, left)
                iteration.keep(kept)
                owners = owners[kept]
            for one in active:
                self._states[one].qpos[:] = self._positions[one]
                self._states[one].qvel[:] = self._velocities[one]
        self._correct(iteration, wanted, starts, active)

    def _correct(
        self, iteration: LiftIteration, wanted: FloatArray, starts: list[int], active: list[int]
    ) -> None:
        iteration.correct(wanted)
        for one in active:
            self._states[one].efc_aref[:] = wanted[starts[one] : starts[one + 1]]
        self._advance(active)

    def _stack_contacts(self) -> MjRows:
        contacts = [data.contact for data in self._states]
        if len(contacts) == 1:
            return contacts[0]
        starts = accumulate((data.nefc for data in self._states), initial=0)
        addresses = [contact.efc_address for contact in contacts]
        offsets = np.repeat(list(starts)[:-1], [len(own) for own in addresses])
        first = np.concatenate(addresses)
        return StackedContacts(
            np.concatenate([contact.dim for contact in contacts]),
            np.where(first >= 0, first + offsets, first).astype(np.int32),
            np.concatenate([contact.friction for contact in contacts]),
        )

    def _advance(self, chosen: Sequence[int]) -> None:
        """Solve and integrate some worlds; otherwise where Newton's method failed.

        It rarely fails, with many contacts that contradict each other.
        """
        if not chosen:
            return
        for one in chosen:
            mujoco.mj_step2(self._model, self._states[one])
        before = _join([self._velocities[one] for one in chosen])
        changes = _join([self._states[one].qvel for one in chosen]) - before
        # False for NaN, so that small changes are finite, and speeds with them.
        most, least = changes.max(initial=0.0), changes.min(initial=0.0)
        if most <= MAX_SPEED_CHANGE and least >= -MAX_SPEED_CHANGE:
            return
        for one, change in zip(chosen, changes.reshape(len(chosen), -1), strict=True):
            if not (np.abs(change) <= MAX_SPEED_CHANGE).all():
                self.suspects.add(one)
                start = self._positions[one], self._velocities[one]
                self._solve_again(one, start, change)


def _join(arrays: list[FloatArray]) -> FloatArray:
    """Join the rows of all worlds; those of a single one stay where they are."""
    return arrays[0] if len(arrays) == 1 else np.concatenate(arrays)
