"""Showing: a journal for people, and all of it for programs."""

import json
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from tests.engines import STEP_NS, ObedientEngine
from tests.models import a_box, a_cart, on_ground
from tests.sim_server.fakes import CONTROL_STEPS, a_spawn, a_world, names_in
from tests.sim_server.journal.journaled_server import Journalled, contents_in
from zensim.proto.messages.entity_messages import Category, EntityCategory, EntityInfo
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.simulation_messages import ResetScope, State
from zensim.sim_server.errors import SimError
from zensim.sim_server.journal.journal_contents import (
    commit_restore,
    export_journal,
    format_summary,
    read_contents,
    summarize_journal,
)
from zensim.sim_server.journal.journal_records import ExcludedEntityRow
from zensim.sim_server.journal.server_journal import RESTORE_MARK_FILE, Journal, open_journal
from zensim.sim_server.journal.sqlite_store import JournalError, open_store
from zensim.sim_server.parser_process.description_cache import ParseKey
from zensim.sim_server.physics.engine import EngineRefused, FloatArray
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.world.simulated_world import World

NAMES = st.sampled_from(["r0", "r1", "r2"])


def told(world: World) -> list[tuple[object, ...]]:
    """List what must be the same after a restart."""
    reading, roster = world.states(), world.entities.index
    return [
        (
            *(entity.name, entity.namespace, entity.model, entity.description, entity.info),
            entity.belongs_to_world,
            entity.initial.tolist(),
            reading.base[row, :7].tolist(),
            reading.joint_positions[roster.joints_of(entity.name)].tolist(),
        )
        for row, entity in enumerate(world.entities)
    ]


def restart(kept: Journalled) -> Journalled:
    kept.crash()
    return Journalled(kept.folder)


def test_restored_world_is_as_it_was(tmp_path: Path) -> None:
    kept = Journalled(tmp_path, "r0", "r1")
    kept.world.spawn(a_spawn("box", model=a_box(), base=on_ground(5.0)))
    info = EntityInfo(EntityCategory(Category.HUMAN), "a box", ("a", "b"))
    kept.world.set_info("box", info)
    kept.world.place("r1", on_ground(3.0, 2.0, 1.0), np.array([0.5, -0.25]))
    kept.world.clock.pause()
    kept.recorder.note(is_asked=True)
    expected = told(kept.world)

    again = restart(kept)

    assert told(again.world) == expected
    assert again.world.clock.state == State.PAUSED
    assert again.world.entities.find("box").info == info


def test_time_goes_on_in_a_higher_epoch(tmp_path: Path) -> None:
    kept = Journalled(tmp_path, "r0")
    kept.server.turn_for(1.0)
    kept.world.reset(ResetScope.TIME)
    kept.server.turn_for(1.0)
    before = kept.world.clock.steps

    again = restart(kept)

    assert again.world.clock.epoch == 2
    assert 0.5 < (before - again.world.clock.steps) * STEP_NS * 1e-9 + 0.5 <= 1.0


def test_epoch_is_higher_even_when_the_last_start_did_nothing(tmp_path: Path) -> None:
    kept = Journalled(tmp_path, "r0")
    kept.recorder.note()

    epochs = []
    for _ in range(3):
        kept = restart(kept)
        epochs.append(kept.world.clock.epoch)

    assert epochs == [1, 2, 3]


def test_description_that_was_read_need_not_be_read_again(tmp_path: Path) -> None:
    kept = Journalled(tmp_path)
    kept.recorder.note()
    entity = kept.world.spawn(a_spawn("r0"))
    reading = ParseKey("<robot/>", "gazebo11", allow_missing=True, assets=())
    kept.parts.descriptions.provider.remember(reading, entity.model)
    kept.recorder.note()

    again = restart(kept)

    model = again.world.entities.find("r0").model
    assert again.parts.descriptions.provider.find_parse_key(model) == reading


def test_robot_stands_and_what_nobody_drives_moves_on(tmp_path: Path) -> None:
    kept = Journalled(tmp_path, "r0")
    kept.world.spawn(a_spawn("ball", model=a_box(), base=on_ground(5.0)))
    moving = on_ground(1.0)
    moving[7] = 0.5
    for name in ("r0", "ball"):
        kept.world.place(name, moving)
    kept.recorder.note(is_asked=True)

    again = restart(kept)

    assert again.world.state_of("r0")[7] == 0.0
    assert again.world.state_of("ball")[7] == 0.5


def test_entity_that_is_refused_now_is_set_aside_and_named(tmp_path: Path) -> None:
    kept = Journalled(tmp_path, "r0", "r1")
    kept.recorder.note()
    kept.crash()

    class Choosy(ObedientEngine):
        def add(self, model: Model, base: FloatArray) -> int:
            if base[0] == 1.0:
                raise EngineRefused("not this one")
            return super().add(model, base)

    world = World(
        Choosy(EngineConfig(STEP_NS)),
        name="default",
        step_ns=STEP_NS,
        control_steps=CONTROL_STEPS,
    )
    again = Journalled(tmp_path, world=world)

    assert names_in(again.world) == ["r0"]
    assert again.refused == ("r1",)
    third = restart(again)
    assert names_in(third.world) == ["r0"]
    third.crash()
    (aside,) = contents_in(tmp_path).aside
    assert aside.entity.name == "r1"
    assert "not this one" in aside.reason


class Deadly(ObedientEngine):
    """Ends the process with what stands at x = 1."""

    def add(self, model: Model, base: FloatArray) -> int:
        if base[0] == 1.0:
            raise SystemExit(9)
        return super().add(model, base)


def test_entity_that_kills_is_set_aside_after_a_start_that_died(tmp_path: Path) -> None:
    kept = Journalled(tmp_path, "r0", "r1", "r2")
    kept.recorder.note()
    kept.crash()

    def starting() -> Journal:
        journal = open_journal(str(tmp_path))
        journal.exclude_crashing(lambda: Deadly(EngineConfig(STEP_NS)))
        return journal

    first = starting()
    assert first.contents is not None
    assert len(first.contents.entities) == 3
    (tmp_path / RESTORE_MARK_FILE).touch()  # as a start leaves it that died while it restored
    first.close()
    second = starting()

    assert second.contents is not None
    assert [row.name for row in second.contents.entities] == ["r0", "r2"]
    assert "twice" in second.contents.aside[0].reason
    second.close()


def test_mark_is_gone_after_a_restore_that_worked(tmp_path: Path) -> None:
    kept = Journalled(tmp_path, "r0")
    kept.recorder.note()

    restart(kept)

    assert not (tmp_path / RESTORE_MARK_FILE).exists()


def test_journal_that_cannot_be_understood_is_one_line(tmp_path: Path) -> None:
    ledger = open_store(tmp_path)
    ledger.begin()
    ledger.put("world", "", b"\xc1")
    ledger.commit(1)

    with pytest.raises(JournalError, match="holds what cannot be read"):
        read_contents(ledger)
    ledger.close()


class AnyHistory(RuleBasedStateMachine):
    """Operations and restarts in any order: the world is always that of a twin without journal."""

    def __init__(self) -> None:
        super().__init__()
        self.folder = tempfile.TemporaryDirectory()
        self.begin()
        self.twin = a_world()

    def begin(self) -> None:
        self.kept = Journalled(Path(self.folder.name))
        self.kept.recorder.note()

    def both(self, act: Callable[[World], object]) -> None:
        for world in (self.kept.world, self.twin):
            with suppress(SimError):
                act(world)
        self.kept.recorder.note(is_asked=True)

    @rule(name=NAMES, is_cart=st.booleans(), x=st.integers(-5, 5))
    def spawn(self, name: str, *, is_cart: bool, x: int) -> None:
        model = a_cart() if is_cart else a_box()
        self.both(lambda world: world.spawn(a_spawn(name, model=model, base=on_ground(float(x)))))

    @rule(name=NAMES)
    def delete(self, name: str) -> None:
        self.both(lambda world: world.delete(name))

    @rule(name=NAMES, x=st.floats(-9.0, 9.0))
    def place(self, name: str, x: float) -> None:
        self.both(lambda world: world.place(name, on_ground(x)))

    @rule(name=NAMES, tag=st.text(max_size=3))
    def set_info(self, name: str, tag: str) -> None:
        self.both(lambda world: world.set_info(name, EntityInfo(tags=(tag,))))

    @rule(scope=st.sampled_from([1, 2, 4, 255]))
    def reset(self, scope: int) -> None:
        self.both(lambda world: world.reset(scope))

    @rule()
    def fail(self) -> None:
        self.kept.disk.is_full = True
        for name in names_in(self.kept.world)[:1]:
            self.kept.world.delete(name)
        self.kept.world.spawn(a_spawn("lost"))
        self.kept.recorder.note(is_asked=True)
        self.kept.disk.is_full = False
        assert self.kept.recorder.poll()

    @rule()
    def restart(self) -> None:
        self.kept.crash()
        self.begin()

    @invariant()
    def worlds_are_the_same(self) -> None:
        assert sorted(told(self.kept.world)) == sorted(told(self.twin))

    def teardown(self) -> None:
        self.kept.crash()
        self.kept.parts.store.close()
        self.folder.cleanup()


TestAnyHistory = AnyHistory.TestCase
TestAnyHistory.settings = settings(max_examples=12, stateful_step_count=12, deadline=None)


def test_page_lists_entities_and_who_is_set_aside(tmp_path: Path) -> None:
    kept = Journalled(tmp_path, "r0", "r1")
    kept.recorder.note()
    contents = read_contents(kept.ledger)
    assert contents is not None
    commit_restore(kept.ledger, [ExcludedEntityRow(entity=contents.entities[1], reason="it kills")])

    shown = format_summary(summarize_journal(kept.ledger, read_contents(kept.ledger)))

    assert "entities: 1\n  r0  ns=r0  model=cart  at 0.000 0.000 0.050\n" in shown
    assert shown.endswith("set aside: 1\n  r1: it kills")


def test_export_holds_descriptions_and_is_json(tmp_path: Path) -> None:
    kept = Journalled(tmp_path, "r0")
    kept.recorder.note()

    found = json.loads(json.dumps(export_journal(kept.ledger, read_contents(kept.ledger))))

    assert found["descriptions"] == {"r0": "<robot/>"}
    assert found["entities"][0]["joints"] == {"right_joint": 0.0, "left_joint": 0.0}
    assert found["world_source"]["name"] == "empty"


def test_journal_that_was_just_begun_is_shown_as_empty(tmp_path: Path) -> None:
    ledger = open_store(tmp_path)

    assert format_summary(summarize_journal(ledger, read_contents(ledger))).endswith(
        "entities: 0\nset aside: 0"
    )
    assert export_journal(ledger, None)["entities"] == []
