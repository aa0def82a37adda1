"""Claims of agents on entities, and the newest targets of each agent."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from zensim.proto.messages.agent_messages import DriveCommand, DriveState, OnRelease
from zensim.proto.messages.result_messages import ClaimCode
from zensim.sim_server.errors import RequestRefused
from zensim.sim_server.physics.engine import BodyStates, FloatArray, IntArray
from zensim.sim_server.scene.broad_phase import expand_ranges
from zensim.sim_server.world.entity import Entity, EntityIndex


@dataclass(frozen=True)
class ClaimRecord:
    """The agent that drives an entity, and the number of its claim."""

    claim: int
    agent: str
    on_release: OnRelease


@dataclass(frozen=True)
class ClaimedEntities:
    """The entities that one agent drives: rows in the state arrays, and bodies to command."""

    claims: bytes
    rows: IntArray
    joints: IntArray
    bodies: tuple[int, ...]
    target_count: int
    joint_targets: tuple[tuple[str, slice], ...] = ()
    """Entities with controlled joints, and where their targets are; empty for most agents."""

    def to_drive_state(
        self, now: tuple[int, int, int], states: BodyStates, efforts: FloatArray | None
    ) -> DriveState:
        """Select the states of these entities.

        Args:
            now: Epoch, step and simulation time [ns].
            states: Of all entities.
            efforts: Of the joints of these entities; None if their agent does not want them.
        """
        return DriveState(
            *now,
            self.claims,
            states.base[self.rows].tobytes(),
            states.joint_positions[self.joints].tobytes(),
            states.joint_velocities[self.joints].tobytes(),
            joint_efforts=b"" if efforts is None else efforts.tobytes(),
        )


@dataclass(frozen=True)
class EffortPlan:
    """The bodies whose joint efforts are read for some agents.

    Attributes:
        claimed: What each agent drives; another mapping needs another plan.
        agents: Those that want efforts.
        bodies: Of all of them, agent by agent.
        ends: Ends in the joints of these bodies, by agent.
    """

    claimed: Mapping[str, ClaimedEntities]
    agents: tuple[str, ...]
    bodies: tuple[int, ...]
    ends: IntArray


def make_effort_plan(claimed: Mapping[str, ClaimedEntities], agents: tuple[str, ...]) -> EffortPlan:
    """Collect the bodies of some agents."""
    bodies = tuple(body for agent in agents for body in claimed[agent].bodies)
    joints = [len(claimed[agent].joints) for agent in agents]
    return EffortPlan(claimed, agents, bodies, np.cumsum(joints, dtype=np.intp))


@dataclass(frozen=True, slots=True)
class DrivenClaims:
    """The claims of an agent that its last command was for.

    Attributes:
        newest: No later claim is among them; an agent commands all that it has.
        count: Of those that it still has.
    """

    newest: int
    count: int


RejectionReason = Literal["malformed", "claims", "step"]
"""Why a command has no effect: its bytes, claims that are none of its agent's, or a former step."""


class ClaimRegistry:
    """Claims by entity; each entity has at most one driver."""

    def __init__(self) -> None:
        self.rejected: Counter[RejectionReason] = Counter()
        """Number of commands without effect, by reason."""
        self.taken = 0
        """Number of commands that took effect."""
        self.changes = 0
        """Number of claims that were granted or ended."""
        self.silent: set[str] = set()
        """Agents whose robots were stopped because no command came; the next command ends this."""
        self._claims: dict[str, ClaimRecord] = {}
        self._counts: Counter[str] = Counter()
        self._next_claim = 1
        self._driven: dict[str, DrivenClaims] = {}
        self._targets: dict[str, FloatArray] = {}
        self._wanting_efforts: set[str] = set()
        self._without_claims: set[str] = set()
        self._claimed: dict[str, ClaimedEntities] | None = None

    def __len__(self) -> int:
        return len(self._claims)

    @property
    def dropped(self) -> int:
        """Number of commands without effect."""
        return sum(self.rejected.values())

    @property
    def driven(self) -> int:
        """Number of claims whose agent has sent a command since it has them."""
        return sum(one.count for one in tuple(self._driven.values()))

    @property
    def newest(self) -> int:
        """Number of the last claim granted; 0 before the first."""
        return self._next_claim - 1

    @property
    def agents(self) -> tuple[str, ...]:
        """Agents that have a claim."""
        return tuple(dict.fromkeys(record.agent for record in self._claims.values()))

    @property
    def agent_count(self) -> int:
        """Number of agents that have a claim."""
        return sum(count > 0 for count in self._counts.values())

    def agent_of(self, name: str) -> str:
        """Find the agent that drives an entity; empty if none does."""
        record = self._claims.get(name)
        return record.agent if record else ""

    def is_driven(self, name: str) -> bool:
        """Whether the agent of an entity has sent a command since it has the entity."""
        if (record := self._claims.get(name)) is None:
            return False
        driven = self._driven.get(record.agent)
        return driven is not None and record.claim <= driven.newest

    def require_free(self, name: str, agent: str) -> None:
        """Check that no other agent drives an entity, silent ones aside.

        Raises:
            RequestRefused: Another agent drives the entity.
        """
        holder = self.agent_of(name)
        if holder not in ("", agent) and holder not in self.silent:
            raise RequestRefused(
                ClaimCode.ALREADY_CLAIMED,
                f"entity '{name}' is driven by agent '{holder}'; stop that agent first",
            )

    def list_claims(self, agent: str) -> list[tuple[str, ClaimRecord]]:
        """List the claims of an agent with the names of entities, in the order of claiming."""
        return [(name, record) for name, record in self._claims.items() if record.agent == agent]

    def grant(self, agent: str, name: str, on_release: OnRelease) -> ClaimRecord:
        """Make an agent the driver of an entity."""
        record = ClaimRecord(self._next_claim, agent, on_release)
        self._next_claim += 1
        if (before := self._claims.get(name)) is not None:
            self._counts[before.agent] -= 1
            self._forget_driven(before)
        self._claims[name] = record
        self._counts[agent] += 1
        self.changes += 1
        self.invalidate_rows()
        self._targets.pop(agent, None)
        self._without_claims.discard(agent)
        return record

    def drop(self, name: str) -> None:
        """End the claim on an entity, if there is one."""
        if (record := self._claims.pop(name, None)) is None:
            return
        self._counts[record.agent] -= 1
        self._forget_driven(record)
        self.changes += 1
        self.invalidate_rows()
        self._targets.pop(record.agent, None)
        if not self._counts[record.agent]:
            del self._counts[record.agent]
            self.silent.discard(record.agent)
            self._without_claims.add(record.agent)

    def forget_agent(self, agent: str) -> None:
        """Send no further state to an agent: it has ended."""
        self.silent.discard(agent)
        self._without_claims.discard(agent)
        self._wanting_efforts.discard(agent)
        self._driven.pop(agent, None)

    def take_agents_without_claims(self) -> list[str]:
        """Take the agents that lost their last claim since the previous call."""
        agents, self._without_claims = sorted(self._without_claims), set()
        return agents

    def invalidate_rows(self) -> None:
        """Drop cached rows: entities, bodies or claims have changed."""
        self._claimed = None

    def claimed_by_agent(
        self, index: EntityIndex, entities: Mapping[str, Entity]
    ) -> dict[str, ClaimedEntities]:
        """Find what each agent drives."""
        if self._claimed is None:
            members: dict[str, list[tuple[Entity, ClaimRecord]]] = {}
            for name, record in self._claims.items():
                members.setdefault(record.agent, []).append((entities[name], record))
            self._claimed = {
                agent: _select_claimed(index, claimed) for agent, claimed in members.items()
            }
        return self._claimed

    def command(self, agent: str, claimed: ClaimedEntities | None, command: DriveCommand) -> bool:
        """Keep the targets of an agent until they are taken, if they match its claims."""
        targets = None if claimed is None else _decode_targets(claimed, command)
        if targets is None:
            self.rejected["claims"] += 1
            return False
        self._targets[agent] = targets
        self._driven[agent] = DrivenClaims(self.newest, self._counts[agent])
        self.silent.discard(agent)
        if command.wants_efforts:
            self._wanting_efforts.add(agent)
        else:
            self._wanting_efforts.discard(agent)
        self.taken += 1
        return True

    def wants_efforts(self, agent: str) -> bool:
        """Whether an agent wants the efforts of joints, by its last command."""
        return agent in self._wanting_efforts

    def take_targets(self) -> Mapping[str, FloatArray]:
        """Take the targets of each agent for the next step."""
        targets = self._targets
        if targets:
            self._targets = {}
        return targets

    def note_silent(self, agent: str) -> None:
        """Note that an agent has sent no command for too long; its last targets are dropped."""
        self.silent.add(agent)
        self._driven.pop(agent, None)
        self._targets.pop(agent, None)

    def forget_targets(self) -> None:
        """Drop all targets."""
        self._targets = {}

    def _forget_driven(self, record: ClaimRecord) -> None:
        driven = self._driven.get(record.agent)
        if driven is not None and record.claim <= driven.newest:
            self._driven[record.agent] = DrivenClaims(driven.newest, driven.count - 1)


def _select_claimed(
    index: EntityIndex, members: Sequence[tuple[Entity, ClaimRecord]]
) -> ClaimedEntities:
    """Find the rows of an agent's entities, in the order of claiming."""
    rows = np.array([index.row[entity.name] for entity, _ in members], dtype=np.intp)
    return ClaimedEntities(
        claims=np.array([record.claim for _, record in members], dtype="<u4").tobytes(),
        rows=rows,
        joints=expand_ranges(index.joint_start[rows], index.joint_count[rows])[1],
        bodies=tuple([entity.body for entity, _ in members]),
        target_count=sum([entity.target_count for entity, _ in members]),
        joint_targets=tuple(_find_joint_targets(members)),
    )


def _find_joint_targets(
    members: Sequence[tuple[Entity, ClaimRecord]],
) -> Iterator[tuple[str, slice]]:
    end = 0
    for entity, _ in members:
        start, end = end, end + entity.target_count
        if entity.model.joint_controllers:
            yield entity.name, slice(start, end)


def _decode_targets(claimed: ClaimedEntities, command: DriveCommand) -> FloatArray | None:
    if command.claims != claimed.claims or len(command.targets) != 8 * claimed.target_count:
        return None
    targets = np.frombuffer(command.targets, dtype="<f8")
    return targets if np.isfinite(targets).all() else None
