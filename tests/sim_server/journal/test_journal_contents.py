"""A journal is restored into an equal world, summarized and exported."""

import errno
import hashlib
import json
import tempfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from tests.engines import STEP_NS, ObedientEngine
from tests.models import a_body, a_box, a_cart, on_ground
from tests.sim_server.fakes import CONTROL_STEPS, a_spawn, a_world, names_in
from tests.sim_server.journal.journaled_server import JournaledServer, read_journal
from zensim.proto.messages.entity_messages import Category, EntityCategory, EntityInfo
from zensim.proto.messages.model_messages import Link, Model, Shape
from zensim.proto.messages.simulation_messages import ResetScope, State
from zensim.proto.stl import write_corners
from zensim.sim_server.errors import SimError
from zensim.sim_server.journal import server_journal
from zensim.sim_server.journal.journal_contents import (
    backup_journal,
    commit_restore,
    export_journal,
    find_damaged_files,
    format_summary,
    read_contents,
    summarize_journal,
)
from zensim.sim_server.journal.journal_records import ExcludedEntityRow
from zensim.sim_server.journal.restore_progress import RESTORE_MARK_FILE
from zensim.sim_server.journal.server_journal import Journal, open_journal
from zensim.sim_server.journal.sqlite_store import (
    FILES,
    JournalError,
    open_store,
    open_store_read_only,
)
from zensim.sim_server.parser_process.description_cache import ParseKey
from zensim.sim_server.physics.engine import EngineLost, EngineRefused, FloatArray, Place
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.world.simulated_world import SimulatedWorld

NAMES = st.sampled_from(["r0", "r1", "r2"])


def describe(world: SimulatedWorld) -> list[tuple[object, ...]]:
    """List what a restart must not change."""
    states, index = world.states(), world.entities.index
    return [
        (
            *(entity.name, entity.namespace, entity.model, entity.description, entity.info),
            entity.belongs_to_world,
            entity.initial.tolist(),
            states.base[row, :7].tolist(),
            states.joint_positions[index.joints_of(entity.name)].tolist(),
        )
        for row, entity in enumerate(world.entities)
    ]


def restart(server: JournaledServer) -> JournaledServer:
    server.crash()
    return JournaledServer(server.folder)


def test_restored_world_equals_the_former(tmp_path: Path) -> None:
    server = JournaledServer(tmp_path, "r0", "r1")
    server.world.spawn(a_spawn("box", model=a_box(), base=on_ground(5.0)))
    info = EntityInfo(EntityCategory(Category.HUMAN), "a box", ("a", "b"))
    server.world.set_info("box", info)
    server.world.place("r1", on_ground(3.0, 2.0, 1.0), np.array([0.5, -0.25]))
    server.world.clock.pause()
    server.tracker.record(is_requested=True)
    expected = describe(server.world)

    restarted = restart(server)

    assert describe(restarted.world) == expected
    assert restarted.world.clock.state == State.PAUSED
    assert restarted.world.entities.find("box").info == info


def test_restore_places_only_what_is_not_where_it_was_made(tmp_path: Path) -> None:
    server = JournaledServer(tmp_path, "standing", "turned")
    server.world.place("turned", on_ground(3.0), np.array([0.5, -0.25]))
    server.world.spawn(a_spawn("driven", model=a_box(), base=on_ground(5.0)))
    server.world.place("driven", np.array([*on_ground(5.0)[:7], 1.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    server.tracker.record(is_requested=True)
    expected = describe(server.world)

    restarted = restart(server)

    assert describe(restarted.world) == expected
    assert restarted.world.placement_count == 2


def test_time_continues_in_a_higher_epoch(tmp_path: Path) -> None:
    server = JournaledServer(tmp_path, "r0")
    server.server.turn_for(1.0)
    server.world.reset(ResetScope.TIME)
    server.server.turn_for(1.0)
    before = server.world.clock.steps

    restarted = restart(server)

    assert restarted.world.clock.epoch == 2
    assert 0.5 < (before - restarted.world.clock.steps) * STEP_NS * 1e-9 + 0.5 <= 1.0


def test_epoch_is_higher_even_when_the_last_start_did_nothing(tmp_path: Path) -> None:
    server = JournaledServer(tmp_path, "r0")
    server.tracker.record()

    epochs = []
    for _ in range(3):
        server = restart(server)
        epochs.append(server.world.clock.epoch)

    assert epochs == [1, 2, 3]


def test_parsed_descriptions_are_restored(tmp_path: Path) -> None:
    server = JournaledServer(tmp_path)
    server.tracker.record()
    entity = server.world.spawn(a_spawn("r0"))
    key = ParseKey("<robot/>", "gazebo11", allow_missing=True, assets=())
    server.parts.descriptions.provider.remember(key, entity.model)
    server.tracker.record()

    restarted = restart(server)

    model = restarted.world.entities.find("r0").model
    assert restarted.parts.descriptions.provider.find_parse_key(model) == key


def test_robots_are_restored_at_rest_and_other_entities_with_their_speed(tmp_path: Path) -> None:
    server = JournaledServer(tmp_path, "r0")
    server.world.spawn(a_spawn("ball", model=a_box(), base=on_ground(5.0)))
    moving = on_ground(1.0)
    moving[7] = 0.5
    for name in ("r0", "ball"):
        server.world.place(name, moving)
    server.tracker.record(is_requested=True)

    restarted = restart(server)

    assert restarted.world.state_of("r0")[7] == 0.0
    assert restarted.world.state_of("ball")[7] == 0.5


def reuse_name(server: JournaledServer) -> None:
    """Delete a cart at x = 4 and spawn a box with its name, one recorded request each."""
    server.world.place("r0", on_ground(4.0), np.array([0.5, -0.25]))
    server.tracker.record(is_requested=True)
    server.world.delete("r0")
    server.tracker.record(is_requested=True)
    server.world.spawn(a_spawn("r0", model=a_box(), base=on_ground(1.0)))
    server.tracker.record(is_requested=True)


def test_entity_does_not_get_the_state_of_a_deleted_one_of_its_name(tmp_path: Path) -> None:
    server = JournaledServer(tmp_path, "r0")
    reuse_name(server)

    restarted = restart(server)

    assert restarted.world.state_of("r0")[0] == 1.0


def test_undo_does_not_give_the_state_of_a_deleted_entity_of_the_name(tmp_path: Path) -> None:
    server = JournaledServer(tmp_path, "r0")
    reuse_name(server)
    server.disk.is_full = True

    server.world.delete("r0")
    server.tracker.record(is_requested=True)

    assert server.tracker.poll()
    assert server.world.state_of("r0")[0] == 1.0


def test_entity_that_fails_in_the_first_step_stays_frozen(tmp_path: Path) -> None:
    server = JournaledServer(tmp_path, "r0", "r1")
    server.tracker.record()
    server.crash()

    class FailingEngine(ObedientEngine):
        """The robot at x = 1 diverges in the first step, and cannot be made twice."""

        failing: int | None = None

        def add(self, model: Model, base: FloatArray) -> int:
            if model.is_static or base[0] != 1.0:
                return super().add(model, base)
            if self.failing is not None:
                raise EngineRefused("not again")
            self.failing = super().add(model, base)
            return self.failing

        def step(self) -> bool:
            assert self.failing is not None
            self.set_base_state(self.failing, np.full(13, np.nan))
            return False

    world = SimulatedWorld(
        FailingEngine(EngineConfig(STEP_NS)),
        name="default",
        step_ns=STEP_NS,
        control_steps=CONTROL_STEPS,
    )
    restarted = JournaledServer(tmp_path, world=world)

    assert names_in(restarted.world) == ["r0", "r1"]
    assert restarted.world.divergence_guard.is_frozen("r1")


def test_entity_that_is_refused_is_excluded_and_named(tmp_path: Path) -> None:
    server = JournaledServer(tmp_path, "r0", "r1")
    server.tracker.record()
    server.crash()

    class SelectiveEngine(ObedientEngine):
        def add(self, model: Model, base: FloatArray) -> int:
            if base[0] == 1.0:
                raise EngineRefused("not this one")
            return super().add(model, base)

    world = SimulatedWorld(
        SelectiveEngine(EngineConfig(STEP_NS)),
        name="default",
        step_ns=STEP_NS,
        control_steps=CONTROL_STEPS,
    )
    restarted = JournaledServer(tmp_path, world=world)

    assert names_in(restarted.world) == ["r0"]
    assert restarted.refused == ("r1",)
    third = restart(restarted)
    assert names_in(third.world) == ["r0"]
    third.crash()
    (excluded,) = read_journal(tmp_path).aside
    assert excluded.entity.name == "r1"
    assert "not this one" in excluded.reason


class CrashingEngine(ObedientEngine):
    """Ends the process when a body is added at x = 1."""

    def add(self, model: Model, base: FloatArray) -> int:
        if base[0] == 1.0:
            raise SystemExit(9)
        return super().add(model, base)


def test_entity_that_crashes_is_excluded_after_a_start_that_crashed(tmp_path: Path) -> None:
    server = JournaledServer(tmp_path, "r0", "r1", "r2")
    server.tracker.record()
    server.crash()

    def open_excluding() -> Journal:
        journal = open_journal(str(tmp_path))
        journal.exclude_crashing(lambda: CrashingEngine(EngineConfig(STEP_NS)))
        return journal

    first = open_excluding()
    assert first.contents is not None
    assert len(first.contents.entities) == 3
    (tmp_path / RESTORE_MARK_FILE).touch()  # as left by a start that crashed while restoring
    first.close()
    second = open_excluding()

    assert second.contents is not None
    assert [row.name for row in second.contents.entities] == ["r0", "r2"]
    assert [row.entity.name for row in second.contents.aside] == ["r1"]
    second.close()


def test_entity_that_crashes_the_step_of_all_is_excluded(tmp_path: Path) -> None:
    server = JournaledServer(tmp_path, "r0", "r1", "r2")
    server.tracker.record()
    server.crash()

    class CrashingStep(ObedientEngine):
        """Ends the process when it steps with a body that was made at x = 1."""

        is_fatal = False

        def add(self, model: Model, base: FloatArray) -> int:
            self.is_fatal |= base[0] == 1.0
            return super().add(model, base)

        def step(self) -> bool:
            if self.is_fatal:
                raise SystemExit(9)
            return super().step()

    (tmp_path / RESTORE_MARK_FILE).touch()
    journal = open_journal(str(tmp_path))
    journal.exclude_crashing(lambda: CrashingStep(EngineConfig(STEP_NS)))

    assert journal.contents is not None
    assert [row.name for row in journal.contents.entities] == ["r0", "r2"]
    journal.close()


def test_engine_knows_all_models_and_last_places_before_it_makes_bodies(tmp_path: Path) -> None:
    server = JournaledServer(tmp_path, "r0", "r1")
    server.world.place("r1", on_ground(7.0, 2.0))
    server.tracker.record(is_requested=True)
    server.crash()
    calls: list[object] = []

    class RecordingEngine(ObedientEngine):
        def expect(self, models: Sequence[Model], places: Sequence[Place] = ()) -> None:
            assert len(models) == len(places)
            calls.append(list(places))

        def add(self, model: Model, base: FloatArray) -> int:
            calls.append((float(base[0]), float(base[1])))
            return super().add(model, base)

    world = SimulatedWorld(
        RecordingEngine(EngineConfig(STEP_NS)),
        name="default",
        step_ns=STEP_NS,
        control_steps=CONTROL_STEPS,
    )
    JournaledServer(tmp_path, world=world)

    assert calls == [[(0.0, 0.0), (7.0, 2.0)], (0.0, 0.0), (7.0, 2.0), []]
    assert world.entities.find("r1").initial[0] == 1.0


def test_mark_file_stays_when_a_process_of_the_engine_is_lost(tmp_path: Path) -> None:
    server = JournaledServer(tmp_path, "r0")
    server.tracker.record()
    server.crash()

    class LostEngine(ObedientEngine):
        def step(self) -> bool:
            raise EngineLost("a worker ended")

    world = SimulatedWorld(
        LostEngine(EngineConfig(STEP_NS)),
        name="default",
        step_ns=STEP_NS,
        control_steps=CONTROL_STEPS,
    )
    with pytest.raises(EngineLost):
        JournaledServer(tmp_path, world=world)

    assert (tmp_path / RESTORE_MARK_FILE).exists()


def test_mark_file_is_removed_after_a_restore(tmp_path: Path) -> None:
    server = JournaledServer(tmp_path, "r0")
    server.tracker.record()

    restart(server)

    assert not (tmp_path / RESTORE_MARK_FILE).exists()


def test_mark_file_is_removed_when_a_restore_cannot_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    server = JournaledServer(tmp_path, "r0")
    server.tracker.record()
    server.crash()

    def fail(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(server_journal, "commit_restore", fail)
    with pytest.raises(JournalError):
        JournaledServer(tmp_path)

    assert not (tmp_path / RESTORE_MARK_FILE).exists()


SQUARE = write_corners(np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[1, 1, 0]] * 3]))
SQUARE_NAME = hashlib.sha256(SQUARE).hexdigest()
MESHED = Model(
    "meshed", (Link("base", a_body(), (Shape("mesh", (1.0, 1.0, 1.0), mesh=SQUARE_NAME),)),)
)
DAMAGED = {
    "empty": b"",
    "cut": SQUARE[: len(SQUARE) // 2],
    "flipped": SQUARE[:90] + bytes([SQUARE[90] ^ 1]) + SQUARE[91:],
    "missing": None,
}


def make_meshed_journal(folder: Path) -> Path:
    """Journal carts and an entity with a mesh; return the file of the mesh."""
    server = JournaledServer(folder, "r0", "r1")
    server.parts.store.add(SQUARE_NAME, SQUARE)
    server.world.spawn(a_spawn("m", model=MESHED, base=on_ground(9.0)))
    server.tracker.record()
    server.crash()
    return folder / FILES / f"{SQUARE_NAME}.stl"


@pytest.mark.parametrize("damage", DAMAGED)
def test_entity_whose_mesh_is_damaged_is_excluded_and_may_be_spawned_again(
    tmp_path: Path, damage: str
) -> None:
    file, data = make_meshed_journal(tmp_path), DAMAGED[damage]
    file.unlink()
    if data is not None:
        file.write_bytes(data)

    restarted = JournaledServer(tmp_path)

    assert names_in(restarted.world) == ["r0", "r1"]
    assert restarted.refused == ("m",)
    restarted.parts.store.add(SQUARE_NAME, SQUARE)
    restarted.world.spawn(a_spawn("m", model=MESHED, base=on_ground(9.0)))
    restarted.tracker.record()
    third = restart(restarted)
    assert names_in(third.world) == ["r0", "r1", "m"]


@pytest.mark.parametrize("damage", DAMAGED)
def test_damaged_files_are_found(tmp_path: Path, damage: str) -> None:
    file, data = make_meshed_journal(tmp_path), DAMAGED[damage]
    contents = read_journal(tmp_path)
    before = find_damaged_files(contents, tmp_path / FILES)

    file.unlink()
    if data is not None:
        file.write_bytes(data)

    assert before == ()
    assert find_damaged_files(contents, tmp_path / FILES) == (file.name,)


def test_backup_of_a_used_journal_restores_the_same_world(tmp_path: Path) -> None:
    source, target = tmp_path / "source", tmp_path / "target"
    server = JournaledServer(source, "r0", "r1")
    server.parts.store.add(SQUARE_NAME, SQUARE)
    server.world.spawn(a_spawn("m", model=MESHED, base=on_ground(9.0)))
    server.tracker.record()

    with open_store_read_only(source) as store:
        backup_journal(store, read_contents(store), target)
    server.world.delete("r0")
    server.tracker.record()

    copy = JournaledServer(target)
    assert names_in(copy.world) == ["r0", "r1", "m"]
    assert copy.database.loss == ""
    assert names_in(restart(server).world) == ["r1", "m"]


def test_backup_is_refused_into_a_folder_with_a_journal(tmp_path: Path) -> None:
    make_meshed_journal(tmp_path)

    with open_store_read_only(tmp_path) as store, pytest.raises(JournalError):
        backup_journal(store, read_contents(store), tmp_path)


def test_backup_reports_damaged_meshes(tmp_path: Path) -> None:
    make_meshed_journal(tmp_path / "source").write_bytes(b"")

    with open_store_read_only(tmp_path / "source") as store, pytest.raises(JournalError):
        backup_journal(store, read_contents(store), tmp_path / "target")


def test_journal_that_cannot_be_decoded_is_refused(tmp_path: Path) -> None:
    database = open_store(tmp_path)
    database.begin()
    database.put("world", "", b"\xc1")
    database.commit(1)

    with pytest.raises(JournalError):
        read_contents(database)
    database.close()


class AnyHistory(RuleBasedStateMachine):
    """After any operations and restarts the world equals a twin without a journal."""

    def __init__(self) -> None:
        super().__init__()
        self.folder = tempfile.TemporaryDirectory()
        self.start()
        self.twin = a_world()

    def start(self) -> None:
        self.server = JournaledServer(Path(self.folder.name))
        self.server.tracker.record()

    def apply_to_both(self, act: Callable[[SimulatedWorld], object]) -> None:
        for world in (self.server.world, self.twin):
            with suppress(SimError):
                act(world)
        self.server.tracker.record(is_requested=True)

    @rule(name=NAMES, is_cart=st.booleans(), x=st.integers(-5, 5))
    def spawn(self, name: str, *, is_cart: bool, x: int) -> None:
        model = a_cart() if is_cart else a_box()
        self.apply_to_both(
            lambda world: world.spawn(a_spawn(name, model=model, base=on_ground(float(x))))
        )

    @rule(name=NAMES)
    def delete(self, name: str) -> None:
        self.apply_to_both(lambda world: world.delete(name))

    @rule(name=NAMES, x=st.floats(-9.0, 9.0))
    def place(self, name: str, x: float) -> None:
        self.apply_to_both(lambda world: world.place(name, on_ground(x)))

    @rule(name=NAMES, tag=st.text(max_size=3))
    def set_info(self, name: str, tag: str) -> None:
        self.apply_to_both(lambda world: world.set_info(name, EntityInfo(tags=(tag,))))

    @rule(scope=st.sampled_from([1, 2, 4, 255]))
    def reset(self, scope: int) -> None:
        self.apply_to_both(lambda world: world.reset(scope))

    @rule()
    def fail(self) -> None:
        self.server.disk.is_full = True
        for name in names_in(self.server.world)[:1]:
            self.server.world.delete(name)
        self.server.world.spawn(a_spawn("lost"))
        self.server.tracker.record(is_requested=True)
        self.server.disk.is_full = False
        assert self.server.tracker.poll()

    @rule()
    def restart(self) -> None:
        self.server.crash()
        self.start()

    @invariant()
    def worlds_are_the_same(self) -> None:
        assert sorted(describe(self.server.world)) == sorted(describe(self.twin))

    def teardown(self) -> None:
        self.server.crash()
        self.server.parts.store.close()
        self.folder.cleanup()


TestAnyHistory = AnyHistory.TestCase
TestAnyHistory.settings = settings(
    max_examples=settings().max_examples // 4, stateful_step_count=20, deadline=None
)


def test_summary_lists_entities_and_excluded_ones(tmp_path: Path) -> None:
    server = JournaledServer(tmp_path, "r0", "r1")
    server.tracker.record()
    contents = read_contents(server.database)
    assert contents is not None
    commit_restore(
        server.database, [ExcludedEntityRow(entity=contents.entities[1], reason="it crashes")]
    )

    summary = format_summary(summarize_journal(server.database, read_contents(server.database)))

    assert "entities: 1\n  r0  ns=r0  model=cart  at 0.000 0.000 0.050\n" in summary
    assert summary.endswith("set aside: 1\n  r1: it crashes")


def test_export_has_descriptions_and_is_json(tmp_path: Path) -> None:
    server = JournaledServer(tmp_path, "r0")
    server.tracker.record()

    export = json.loads(json.dumps(export_journal(server.database, read_contents(server.database))))

    assert export["descriptions"] == {"r0": "<robot/>"}
    assert export["entities"][0]["joints"] == {"right_joint": 0.0, "left_joint": 0.0}
    assert export["world_source"]["name"] == "empty"


def test_new_journal_is_summarized_as_empty(tmp_path: Path) -> None:
    database = open_store(tmp_path)

    assert format_summary(summarize_journal(database, read_contents(database))).endswith(
        "entities: 0\nset aside: 0"
    )
    assert export_journal(database, None)["entities"] == []
