"""Invariants of World under any sequence of requests, commands and steps."""

import msgspec
import numpy as np
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from tests.engines import STEP_NS, ObedientEngine
from tests.models import a_box, a_cart, on_ground
from tests.sim_server.fakes import a_command, a_spawn, a_world, names_in
from zensim.proto.messages.agent_messages import DriveCommand, OnRelease
from zensim.proto.messages.simulation_messages import ResetScope
from zensim.sim_server.errors import SimError
from zensim.sim_server.physics.engine_config import EngineConfig

NAMES = st.sampled_from(["r0", "r1", "r2", "r0_1", "sim", "no name"])
NAMESPACES = st.sampled_from(["", "r0", "r1", "/team/r2", "world"])
AGENTS = st.sampled_from(["a", "b"])
ON_RELEASE: st.SearchStrategy[OnRelease] = st.sampled_from(["stop", "keep", "delete"])
SCOPES = st.sampled_from([ResetScope.TIME, ResetScope.STATE, ResetScope.SPAWNED, ResetScope.ALL, 3])
MODELS = st.sampled_from([a_cart(), a_box()])


class AnySequence(RuleBasedStateMachine):
    """Requests, commands and steps in any order."""

    def __init__(self) -> None:
        super().__init__()
        self.engine = ObedientEngine(EngineConfig(STEP_NS))
        self.world = a_world(engine=self.engine)
        self.claims: list[int] = []
        self.old_commands: list[tuple[str, DriveCommand]] = []
        self.rosters = {self.world.entities.roster_number: self.world.entities.index.names}

    @rule(name=NAMES, namespace=NAMESPACES, model=MODELS, is_renamed=st.booleans())
    def spawn(self, name: str, namespace: str, model: object, *, is_renamed: bool) -> None:
        before = names_in(self.world)
        request = a_spawn(name, namespace, model=model, allow_renaming=is_renamed)  # type: ignore[arg-type]
        try:
            entity = self.world.spawn(request)
        except SimError:
            assert names_in(self.world) == before
        else:
            assert names_in(self.world) == [*before, entity.name]

    @rule(name=NAMES)
    def delete(self, name: str) -> None:
        before = names_in(self.world)
        try:
            self.world.delete(name)
        except SimError:
            assert name not in before
        else:
            assert names_in(self.world) == [one for one in before if one != name]

    @rule(agent=AGENTS, names=st.lists(NAMES, max_size=3), on_release=ON_RELEASE)
    def claim(self, agent: str, names: list[str], on_release: OnRelease) -> None:
        before = self.list_agents()
        try:
            granted = self.world.claim(agent, tuple(names), on_release)
        except SimError:
            assert self.list_agents() == before
        else:
            self.claims += [claim.claim for claim in granted]
            assert all(self.world.claims.agent_of(name) == agent for name in names)

    @rule(agent=AGENTS)
    def release(self, agent: str) -> None:
        self.world.release(agent)

        assert agent not in self.world.claims.agents

    @rule(agent=AGENTS, speed=st.floats(-5.0, 5.0))
    def command(self, agent: str, speed: float) -> None:
        one = self.world.claimed_by_agent().get(agent)
        count = one.target_count if one else 0
        command = a_command(self.world, agent, *[speed] * count)
        taken, dropped = self.world.claims.taken, self.world.claims.dropped

        is_accepted = self.world.command(agent, command)

        assert is_accepted == (one is not None)
        self.assert_counted(taken, dropped, is_accepted=is_accepted)
        if is_accepted:
            self.old_commands.append((agent, command))

    @rule(data=st.data(), change=st.sampled_from(["none", "epoch", "claims", "targets", "agent"]))
    def send_wrong_command(self, data: st.DataObject, change: str) -> None:
        if not self.old_commands:
            return
        agent, command = data.draw(st.sampled_from(self.old_commands))
        wrong: dict[str, dict[str, object]] = {
            "epoch": {"epoch": command.epoch + 1},
            "claims": {"claims": command.claims + b"\0\0\0\0"},
            "targets": {"targets": command.targets + b"\0"},
        }
        if change == "agent":
            agent = "b" if agent == "a" else "a"
        command = msgspec.structs.replace(command, **wrong.get(change, {}))
        taken, dropped = self.world.claims.taken, self.world.claims.dropped

        is_accepted = self.world.command(agent, command)

        assert is_accepted == (change == "none" and self.is_current(agent, command))
        self.assert_counted(taken, dropped, is_accepted=is_accepted)

    @rule(scope=SCOPES)
    def reset(self, scope: int) -> None:
        epoch = self.world.clock.epoch

        self.world.reset(scope)

        assert self.world.clock.epoch == epoch + 1

    @rule(name=NAMES, x=st.floats(-10.0, 10.0))
    def place(self, name: str, x: float) -> None:
        try:
            self.world.place(name, on_ground(x))
        except SimError:
            assert name not in names_in(self.world)
        else:
            assert self.world.state_of(name)[0] == x

    @rule(steps=st.integers(1, 4))
    def step(self, steps: int) -> None:
        before = self.world.clock.steps
        for _ in range(steps):
            self.world.step()

        assert self.world.clock.steps == before + steps

    @rule()
    def publish_drive_states(self) -> None:
        states = list(self.world.drive_states())

        agents = [agent for agent, _ in states]
        assert len(set(agents)) == len(agents)
        assert set(self.world.claims.agents) <= set(agents)

    @invariant()
    def entities_are_the_bodies_of_the_engine(self) -> None:
        bodies = [entity.body for entity in self.world.entities]

        assert len(set(bodies)) == len(bodies)
        assert set(bodies) == set(self.engine.bodies)

    @invariant()
    def names_and_namespaces_are_unique(self) -> None:
        names = names_in(self.world)
        namespaces = [entity.namespace for entity in self.world.entities]

        assert len(set(names)) == len(names)
        assert len(set(namespaces)) == len(namespaces)

    @invariant()
    def rows_of_the_index_match_the_arrays(self) -> None:
        index, states = self.world.entities.index, self.world.states()

        assert list(index.names) == names_in(self.world)
        assert [index.row[name] for name in index.names] == list(range(len(index.names)))
        assert states.base.shape == (len(index.names), 13)
        assert states.joint_positions.shape == (int(index.joint_count.sum()),)

    @invariant()
    def a_roster_number_has_one_list_of_names(self) -> None:
        names = self.rosters.setdefault(
            self.world.entities.roster_number, self.world.entities.index.names
        )

        assert names == self.world.entities.index.names

    @invariant()
    def claims_are_on_existing_entities(self) -> None:
        driven = [entity.name for entity in self.world.entities if self.agent_of(entity.name)]

        assert len(driven) == len(self.world.claims)
        assert len(set(self.claims)) == len(self.claims)

    @invariant()
    def claimed_rows_are_disjoint(self) -> None:
        claimed = self.world.claimed_by_agent()
        rows = [row for one in claimed.values() for row in one.rows.tolist()]

        assert set(claimed) == set(self.world.claims.agents)
        assert len(set(rows)) == len(rows) == len(self.world.claims)
        for one in claimed.values():
            assert len(one.claims) == 4 * len(one.rows)

    @invariant()
    def everything_is_finite(self) -> None:
        assert np.isfinite(self.world.states().base).all()

    def agent_of(self, name: str) -> str:
        return self.world.claims.agent_of(name)

    def list_agents(self) -> dict[str, str]:
        return {name: self.agent_of(name) for name in names_in(self.world)}

    def is_current(self, agent: str, command: DriveCommand) -> bool:
        one = self.world.claimed_by_agent().get(agent)
        return (
            one is not None
            and one.claims == command.claims
            and command.epoch == self.world.clock.epoch
        )

    def assert_counted(self, taken: int, dropped: int, *, is_accepted: bool) -> None:
        counted = (self.world.claims.taken - taken, self.world.claims.dropped - dropped)

        assert counted == ((1, 0) if is_accepted else (0, 1))


TestAnySequence = AnySequence.TestCase
