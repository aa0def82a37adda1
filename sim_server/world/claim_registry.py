"""Which agent drives which entity, and the newest targets of each agent."""

from collections import Counter
from collections.abc import Iterator, Mapping

import numpy as np

from zensim.proto.messages.agent_messages import DriveCommand, OnRelease
from zensim.proto.messages.result_messages import ClaimCode
from zensim.sim_server.errors import RequestRefused
from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.world.entity import (
    ClaimedEntities,
    ClaimRecord,
    Entity,
    EntityIndex,
    select_claimed,
)


class ClaimRegistry:
    """The holds on entities; each entity has one driver at most."""

    def __init__(self) -> None:
        self.dropped = 0
        """Commands that did not fit."""
        self.taken = 0
        self.changes = 0
        """Counts claims that were granted or ended."""
        self._holds: dict[str, ClaimRecord] = {}
        self._counts: Counter[str] = Counter()
        self._next_claim = 1
        self._targets: dict[str, FloatArray] = {}
        self._emptied: set[str] = set()
        self._fleets: dict[str, ClaimedEntities] | None = None

    def __len__(self) -> int:
        return len(self._holds)

    @property
    def newest(self) -> int:
        """The claim that was granted last; 0 before the first."""
        return self._next_claim - 1

    @property
    def agents(self) -> tuple[str, ...]:
        """Agents that hold something."""
        return tuple(dict.fromkeys(hold.agent for hold in self._holds.values()))

    def agent_of(self, name: str) -> str:
        """Who drives an entity; empty when nobody does."""
        hold = self._holds.get(name)
        return hold.agent if hold else ""

    def require_free(self, name: str, agent: str) -> None:
        """Refuse what another agent drives.

        Raises:
            Refused: Another agent drives the entity.
        """
        if (holder := self.agent_of(name)) not in ("", agent):
            raise RequestRefused(
                ClaimCode.ALREADY_CLAIMED,
                f"entity '{name}' is driven by agent '{holder}'; stop that agent first",
            )

    def list_claims(self, agent: str) -> list[tuple[str, ClaimRecord]]:
        """What an agent drives, in the order of claiming."""
        return [(name, hold) for name, hold in self._holds.items() if hold.agent == agent]

    def grant(self, agent: str, name: str, on_release: OnRelease) -> ClaimRecord:
        """Make an agent the driver of an entity, under a new claim."""
        hold = ClaimRecord(self._next_claim, agent, on_release)
        self._next_claim += 1
        if (before := self._holds.get(name)) is not None:
            self._counts[before.agent] -= 1
        self._holds[name] = hold
        self._counts[agent] += 1
        self.changes += 1
        self.invalidate_rows()
        self._targets.pop(agent, None)
        self._emptied.discard(agent)
        return hold

    def drop(self, name: str) -> None:
        """End the claim on an entity, if there is one; an agent left with nothing is told so."""
        if (hold := self._holds.pop(name, None)) is None:
            return
        self._counts[hold.agent] -= 1
        self.changes += 1
        self.invalidate_rows()
        self._targets.pop(hold.agent, None)
        if not self._counts[hold.agent]:
            del self._counts[hold.agent]
            self._emptied.add(hold.agent)

    def forget_agent(self, agent: str) -> None:
        """Leave nobody to be told: the agent has gone."""
        self._emptied.discard(agent)

    def take_agents_without_claims(self) -> list[str]:
        """Take the agents that have lost their last entity and still are to be told."""
        emptied, self._emptied = sorted(self._emptied), set()
        return emptied

    def invalidate_rows(self) -> None:
        """Cut the fleets anew: entities or claims have changed."""
        self._fleets = None

    def fleets(
        self, roster: EntityIndex, entities: Mapping[str, Entity]
    ) -> dict[str, ClaimedEntities]:
        """What each agent drives, cut out of a roster."""
        if self._fleets is None:
            members: dict[str, list[tuple[Entity, ClaimRecord]]] = {}
            for name, hold in self._holds.items():
                members.setdefault(hold.agent, []).append((entities[name], hold))
            self._fleets = {agent: select_claimed(roster, held) for agent, held in members.items()}
        return self._fleets

    def command(self, agent: str, fleet: ClaimedEntities | None, command: DriveCommand) -> bool:
        """Keep an agent's targets until they are taken; drop and count those that do not fit."""
        targets = None if fleet is None else _decode_targets(fleet, command)
        if targets is None:
            self.dropped += 1
            return False
        self._targets[agent] = targets
        self.taken += 1
        return True

    def take_targets(self) -> Iterator[tuple[str, FloatArray]]:
        """Take what the agents want of the next step."""
        targets, self._targets = self._targets, {}
        yield from targets.items()

    def forget_targets(self) -> None:
        """Drop what the agents wanted: it was meant for another time."""
        self._targets = {}


def _decode_targets(fleet: ClaimedEntities, command: DriveCommand) -> FloatArray | None:
    if command.claims != fleet.claims or len(command.targets) != 8 * fleet.target_count:
        return None
    targets = np.frombuffer(command.targets, dtype="<f8")
    return targets if np.isfinite(targets).all() else None
