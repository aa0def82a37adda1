"""Logs of inputs: both engines repeat them with equal bits; what differs is named."""

from collections.abc import Callable, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
import numpy.typing as npt
import pytest

from tests.engines import ObedientEngine
from tests.models import a_body, a_state
from tests.sim_server.fakes import a_spawn
from tests.sim_server.input_log.logged_worlds import (
    BOX,
    CONTROL_STEPS,
    STEPS_PER_S,
    LoggedWorld,
    RandomInputs,
)
from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.engine_proofs import EngineName
from zensim.proto.messages.input_messages import Inputs
from zensim.proto.messages.model_messages import Link, Model, Shape
from zensim.proto.messages.result_messages import ResultCode
from zensim.proto.messages.simulation_messages import ResetScope
from zensim.proto.messages.spawn_messages import DeleteEntityRequest
from zensim.proto.stl import write_corners
from zensim.sim_server.input_log import log_writer
from zensim.sim_server.input_log.input_records import (
    MAX_MESSAGE_BYTES,
    AnyRecord,
    HostVersions,
    LoggedRoster,
    LogStart,
    RecordedState,
    StateSummer,
    StateSums,
    StoredMesh,
    read_records,
    write_records,
)
from zensim.sim_server.input_log.resimulation import (
    ResimChanges,
    ResimRefused,
    ResimResult,
    Resimulation,
)
from zensim.sim_server.physics.engine import BodyStates, EngineRefused, FloatArray
from zensim.sim_server.physics.engine_calls import (
    REFUSED,
    Add,
    CallTarget,
    Command,
    CommandGroup,
    Steps,
)
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.logged_engine import LoggedEngine

ENGINES: tuple[EngineName, ...] = ("pybullet", "mujoco")
ROBOTS = 4
BUSY_S = 3


def resim(
    messages: Sequence[Inputs], folder: Path, changes: ResimChanges | None = None
) -> ResimResult:
    run = Resimulation(folder, changes or ResimChanges())
    for message in messages:
        run.feed(message)
        if run.is_decided:
            break
    return run.finish()


def record_busy(engine: EngineName, *, seed: int = 1) -> LoggedWorld:
    logged = LoggedWorld(engine)
    logged.spawn_robots(ROBOTS)
    RandomInputs(logged, seed).run(BUSY_S * STEPS_PER_S)
    logged.log.close()
    return logged


@pytest.fixture(scope="module", params=ENGINES)
def busy(request: pytest.FixtureRequest) -> LoggedWorld:
    return record_busy(request.param)


def test_run_repeats_with_equal_bits(busy: LoggedWorld, tmp_path: Path) -> None:
    result = resim(busy.messages, tmp_path)

    assert result.first_difference is None
    assert result.is_exact
    assert (result.steps, result.starts) == (BUSY_S * STEPS_PER_S, 1)
    assert result.control_steps == result.steps // busy.world.control_steps
    assert result.equal_states == result.states == BUSY_S + 1
    assert result.inputs > 100


SIGN, SMALL_BIT = (7, 0x80), (2, 0x01)
"""Byte and bit of a float64."""


def change_command(
    messages: Sequence[Inputs], after_s: float, place_of_bit: tuple[int, int]
) -> tuple[list[Inputs], int]:
    """Flip a bit of the first number of the first command after a time; return its step."""
    byte, bit = place_of_bit
    changed, is_done, step = [], False, 0
    for message in messages:
        records: list[AnyRecord] = list(read_records(message.records)) if message.records else []
        for place, record in enumerate(records):
            is_late = message.step >= after_s * STEPS_PER_S
            if isinstance(record, Command) and record.targets and is_late and not is_done:
                targets = bytearray(record.targets)
                targets[byte] ^= bit
                records[place] = Command(record.group, bytes(targets))
                is_done, step = True, message.step
        (data,) = list(write_records(records)) or [b""]
        changed.append(msgspec.structs.replace(message, records=data))
    assert is_done
    return changed, step


def test_one_changed_byte_of_a_command_is_found_where_it_acts(
    busy: LoggedWorld, tmp_path: Path
) -> None:
    messages, step = change_command(busy.messages, 1.5, SIGN)

    found = resim(messages, tmp_path).first_difference

    assert found is not None
    assert step - CONTROL_STEPS <= found.step <= step + CONTROL_STEPS
    assert found.count >= 1
    assert any("Command r0" in one for one in found.inputs)
    assert found.measured_s is not None
    assert 0.0 <= found.measured_s - found.time_s <= 1.0
    assert found.differences[0].position_m > 0.0
    assert not found.differences[0].is_equal


@pytest.mark.parametrize("engine", ENGINES)
def test_small_change_of_a_command_is_found(engine: EngineName, tmp_path: Path) -> None:
    logged = LoggedWorld(engine)
    logged.spawn_robots(1)
    logged.drive(3.0, 3.1)
    logged.step(STEPS_PER_S // 2)
    logged.drive(3.01, 3.11)
    logged.step(STEPS_PER_S // 2)
    messages, step = change_command(logged.messages, 0.5, SMALL_BIT)

    assert resim(logged.messages, tmp_path).is_equal
    found = resim(messages, tmp_path).first_difference
    assert found is not None
    assert found.entities == ("r0",)
    assert found.step == step


def test_states_are_those_of_the_api(busy: LoggedWorld, tmp_path: Path) -> None:
    result = resim(busy.messages, tmp_path)

    recorded = [one for one in list_records(busy.messages) if isinstance(one, RecordedState)]
    assert result.digest == recorded[-1].digest


def list_records(messages: Sequence[Inputs]) -> list[AnyRecord]:
    return [one for message in messages if message.records for one in read_records(message.records)]


def test_other_engine_gives_distances(busy: LoggedWorld, tmp_path: Path) -> None:
    other: EngineName = "mujoco" if busy.engine == "pybullet" else "pybullet"

    result = resim(busy.messages, tmp_path, ResimChanges(engine=other))

    assert result.engine == other
    assert not result.is_exact
    assert result.first_difference is None
    assert [round(one.time_s) for one in result.distances] == list(range(BUSY_S + 1))
    assert result.distances[0].max_m < result.distances[-1].max_m


def test_other_step_size_takes_as_long(busy: LoggedWorld, tmp_path: Path) -> None:
    result = resim(busy.messages, tmp_path, ResimChanges(step_ns=2_000_000))

    assert result.simulated_s == pytest.approx(BUSY_S, abs=0.01)
    assert result.steps == pytest.approx(BUSY_S * 500, abs=2)
    assert len(result.distances) == BUSY_S + 1
    assert result.distances[0].max_m < 0.05


def test_lost_message_ends_the_run_there(busy: LoggedWorld, tmp_path: Path) -> None:
    messages = busy.messages[:20] + busy.messages[23:]

    result = resim(messages, tmp_path)

    assert result.lost_messages == 3
    assert not result.is_equal
    assert result.simulated_s < 1.0


def test_first_messages_of_a_second_log_are_missed(busy: LoggedWorld, tmp_path: Path) -> None:
    second = [msgspec.structs.replace(one, log="second") for one in busy.messages[3:]]

    result = resim([*busy.messages, *second], tmp_path)

    assert result.lost_messages == 3
    assert result.skipped_messages == len(second)
    assert not result.is_equal


def test_messages_before_a_start_are_counted(busy: LoggedWorld, tmp_path: Path) -> None:
    other = [msgspec.structs.replace(one, log="other") for one in busy.messages[1:4]]

    result = resim([*other, *busy.messages], tmp_path)

    assert (result.lost_messages, result.skipped_messages) == (0, 3)
    assert not result.is_equal


def test_start_without_a_control_step_is_not_equal(tmp_path: Path) -> None:
    logged = LoggedWorld("mujoco")
    logged.spawn_robots(1)
    logged.poll()

    result = resim(logged.messages, tmp_path)

    assert (result.starts, result.control_steps) == (1, 0)
    assert not result.is_equal


def test_difference_before_a_start_with_bodies_is_kept(tmp_path: Path) -> None:
    logged = LoggedWorld("mujoco")
    logged.spawn_robots(1)
    logged.step(8)
    logged.drive(3.0, 3.1)
    logged.step(STEPS_PER_S // 2)
    later = LoggedWorld("mujoco", is_fresh=False)
    later.spawn_robots(1)
    later.poll()
    later.step(STEPS_PER_S)
    messages, _ = change_command(logged.messages, 0.0, SIGN)

    result = resim([*messages, *later.messages], tmp_path)

    assert not result.is_exact
    assert result.first_difference is not None
    assert (result.is_equal, result.is_passed) == (False, False)


def test_repeated_messages_are_left_out(busy: LoggedWorld, tmp_path: Path) -> None:
    messages = [*busy.messages[:30], *busy.messages[20:]]

    assert resim(messages, tmp_path).is_equal


def test_messages_without_a_start_are_refused(busy: LoggedWorld, tmp_path: Path) -> None:
    with pytest.raises(ResimRefused) as refused:
        resim(busy.messages[5:], tmp_path)

    assert refused.value.slug == "resim.no_start"


@pytest.mark.parametrize("field", HostVersions.__struct_fields__)
def test_other_versions_are_refused(busy: LoggedWorld, tmp_path: Path, field: str) -> None:
    messages = with_start(busy.messages, lambda one: replace_version(one, field))

    with pytest.raises(ResimRefused) as refused:
        resim(messages, tmp_path)

    assert refused.value.slug == "resim.other_version"
    assert "1980" in str(refused.value)


def test_other_versions_can_be_compared(busy: LoggedWorld, tmp_path: Path) -> None:
    messages = with_start(busy.messages, lambda one: replace_version(one, "numpy"))

    result = resim(messages, tmp_path, ResimChanges(only_compares=True))

    assert [one.max_m for one in result.distances] == [0.0] * (BUSY_S + 1)


def test_other_formats_are_refused(busy: LoggedWorld, tmp_path: Path) -> None:
    messages = with_start(busy.messages, lambda one: msgspec.structs.replace(one, format=99))

    with pytest.raises(ResimRefused) as refused:
        resim(messages, tmp_path, ResimChanges(only_compares=True))

    assert refused.value.slug == "resim.other_version"


def test_damaged_records_are_refused(busy: LoggedWorld, tmp_path: Path) -> None:
    first = msgspec.structs.replace(busy.messages[0], records=b"\xdd\0\0\0\1\x91\xa4step")

    with pytest.raises(ResimRefused) as refused:
        resim([first], tmp_path)

    assert refused.value.slug == "resim.malformed"


def with_start(messages: Sequence[Inputs], change: Callable[[LogStart], LogStart]) -> list[Inputs]:
    records = [
        change(one) if isinstance(one, LogStart) else one
        for one in read_records(messages[0].records)
    ]
    (data,) = write_records(records)
    return [msgspec.structs.replace(messages[0], records=data), *messages[1:]]


def replace_version(start: LogStart, field: str) -> LogStart:
    versions = msgspec.structs.replace(start.versions, **{field: "1980"})
    return msgspec.structs.replace(start, versions=versions)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("dynamics", ["full", "auto"])
def test_cells_and_tiers_repeat(
    engine: EngineName, dynamics: Literal["full", "auto"], tmp_path: Path
) -> None:
    logged = LoggedWorld(engine, clusters="on", dynamics=dynamics)
    logged.spawn_robots(ROBOTS)
    RandomInputs(logged, seed=2).run(STEPS_PER_S)

    result = resim(logged.messages, tmp_path)

    assert result.is_equal
    assert result.is_exact
    assert result.steps == STEPS_PER_S


@pytest.mark.parametrize("engine", ENGINES)
def test_log_that_begins_later_compares_trajectories(engine: EngineName, tmp_path: Path) -> None:
    logged = LoggedWorld(engine, is_fresh=False)
    logged.spawn_robots(ROBOTS)
    logged.world.spawn(a_spawn("box", model=BOX, base=a_state((0.0, 1.0, 0.1))))
    logged.drive(4.0, 5.0)
    logged.step(STEPS_PER_S)
    logged.poll()
    logged.drive(5.0, 4.0)
    logged.step(2 * STEPS_PER_S)

    result = resim(logged.messages, tmp_path)

    assert not result.is_exact
    assert (result.is_equal, result.is_passed) == (False, False)
    assert resim(logged.messages, tmp_path, ResimChanges(only_compares=True)).is_passed
    assert result.steps == 2 * STEPS_PER_S
    assert len(result.distances) == 3
    assert result.distances[0].max_m < 1e-3
    assert result.distances[-1].max_m < 0.1


@pytest.mark.parametrize("engine", ENGINES)
def test_reset_and_frozen_entities_repeat(engine: EngineName, tmp_path: Path) -> None:
    logged = LoggedWorld(engine)
    logged.spawn_robots(2)
    logged.drive(4.0, 5.0)
    logged.step(STEPS_PER_S)
    far = a_state((3e6, 0.0, 0.5))
    logged.world.place("r1", far)
    logged.step(STEPS_PER_S)
    assert logged.world.divergence_guard.is_frozen("r1")
    logged.world.reset(ResetScope.TIME | ResetScope.STATE)
    logged.drive(5.0, 4.0)
    logged.step(STEPS_PER_S)

    result = resim(logged.messages, tmp_path)

    assert result.first_difference is None
    assert result.is_exact
    assert (result.starts, result.steps) == (1, 3 * STEPS_PER_S)
    assert result.equal_states == result.states >= 3


def test_reset_begins_a_message_so_that_what_follows_can_be_run_alone(tmp_path: Path) -> None:
    logged = LoggedWorld("mujoco")
    logged.spawn_robots(2)
    logged.drive(4.0, 5.0)
    logged.step(STEPS_PER_S + 1)
    logged.world.reset(ResetScope.TIME | ResetScope.STATE)
    logged.step(STEPS_PER_S)

    parts = [[one for one in logged.messages if one.epoch == epoch] for epoch in (0, 1)]

    for epoch, part in enumerate(parts):
        starts = [one for one in list_records(part) if isinstance(one, LogStart)]
        assert [one.epoch for one in starts] == [epoch]
    assert isinstance(next(iter(list_records(parts[1]))), LogStart)
    result = resim(parts[1], tmp_path, ResimChanges(only_compares=True))
    assert (result.starts, result.skipped_messages) == (1, 0)
    assert result.states >= 1


@pytest.mark.parametrize("engine", ENGINES)
def test_meshes_are_in_the_log(engine: EngineName, tmp_path: Path) -> None:
    logged = LoggedWorld(engine)
    data = write_corners(make_wedge(0.2))
    name = sha256(data).hexdigest()
    logged.store.add(name, data)
    link = Link("base", a_body(), (Shape("mesh", (1.0, 1.0, 1.0), mesh=name),))
    wedge = Model("wedge", (link,))
    logged.world.spawn(a_spawn("w0", model=wedge, base=a_state((0.0, 0.0, 0.3))))
    logged.world.spawn(a_spawn("w1", model=wedge, base=a_state((0.1, 0.1, 0.7))))
    logged.step(STEPS_PER_S)
    logged.store.close()

    result = resim(logged.messages, tmp_path)

    assert (result.is_exact, result.is_equal, result.refused_models) == (True, True, {})
    assert sum(isinstance(one, StoredMesh) for one in list_records(logged.messages)) == 1
    assert logged.world.state_of("w0")[2] > -0.01


def make_wedge(side_m: float) -> npt.NDArray[np.float64]:
    """Make the triangles (4, 3, 3) of a tetrahedron."""
    corners = side_m * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=np.float64)
    return corners[[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]]


def test_large_logs_are_published_in_bursts(monkeypatch: pytest.MonkeyPatch) -> None:
    logged = LoggedWorld("mujoco")
    logged.is_wanted = False
    logged.spawn_robots(1)
    for _ in range(20):
        logged.step(4)
    monkeypatch.setattr(log_writer, "MAX_BURST_BYTES", 1)
    logged.is_wanted = True

    logged.poll()
    first = len(logged.messages)
    logged.poll()
    second = len(logged.messages)
    logged.log.close()

    assert (first, second) == (1, 2)
    assert len(logged.messages) > 10
    assert [one.sequence for one in logged.messages] == list(range(len(logged.messages)))


def test_log_that_nobody_takes_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log_writer, "MAX_KEPT_BYTES", 1000)
    logged = LoggedWorld("mujoco")
    logged.is_wanted = False
    logged.spawn_robots(1)

    logged.step(40)

    assert not logged.log.is_active
    assert not isinstance(logged.world.engine, LoggedEngine)
    logged.is_wanted = True
    logged.poll()
    start = read_records(logged.messages[0].records)[0]
    assert isinstance(start, LogStart)
    assert start.origin == "bodies"


def note_requests(logged: LoggedWorld, count: int, characters: int) -> None:
    for number in range(count):
        request = DeleteEntityRequest(f"{number}" + "x" * characters)
        logged.log.note_request("delete_entity", "c", request, ResultCode.OK, "")


def test_requests_after_a_reset_are_in_messages_of_its_epoch() -> None:
    logged = LoggedWorld("mujoco")
    logged.spawn_robots(1)
    logged.poll()
    logged.messages.clear()

    note_requests(logged, 1, 1)
    logged.world.reset(ResetScope.TIME | ResetScope.STATE)
    note_requests(logged, 2, 1)
    logged.poll()

    found = [(one.epoch, len(one.requests)) for one in logged.messages if one.requests]
    assert found == [(0, 1), (1, 2)]


def test_requests_count_as_what_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log_writer, "MAX_KEPT_BYTES", 100_000)
    logged = LoggedWorld("mujoco")
    logged.is_wanted = False

    for _ in range(20):
        note_requests(logged, 1, 10_000)
        logged.poll()

    assert not logged.log.is_active


def test_many_requests_are_several_messages_and_long_ones_are_cut() -> None:
    logged = LoggedWorld("mujoco")
    logged.poll()
    logged.messages.clear()

    note_requests(logged, 100, 1_000_000)
    for _ in range(20):
        logged.poll()

    sizes = [len(encode(one, Format.MSGPACK)) for one in logged.messages]
    assert sum(len(one.requests) for one in logged.messages) == 100
    assert max(sizes) <= MAX_MESSAGE_BYTES + 2 * log_writer.MAX_TEXT_BYTES
    assert [one.sequence for one in logged.messages] == sorted(
        one.sequence for one in logged.messages
    )


def test_log_that_grows_faster_than_it_is_published_begins_anew(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(log_writer, "MAX_KEPT_BYTES", 50_000)
    monkeypatch.setattr(log_writer, "MAX_BURST_BYTES", 1)
    logged = LoggedWorld("mujoco", is_fresh=False)
    logged.poll()
    first = logged.messages[0].log

    for _ in range(20):
        note_requests(logged, 10, 10_000)
        logged.poll()

    last = logged.messages[-1]
    assert last.log != first
    assert any(one.log != first and one.sequence == 0 for one in logged.messages)


@pytest.mark.parametrize("is_wanted", [False, True])
def test_reset_at_which_a_log_is_full_ends_it_and_another_one_begins(
    monkeypatch: pytest.MonkeyPatch, *, is_wanted: bool
) -> None:
    monkeypatch.setattr(log_writer, "MAX_KEPT_BYTES", 50_000)
    logged = LoggedWorld("mujoco", is_fresh=not is_wanted)
    logged.is_wanted = is_wanted
    logged.spawn_robots(1)
    logged.poll()
    logged.messages.clear()
    note_requests(logged, 20, 10_000)
    logged.world.reset(ResetScope.TIME | ResetScope.STATE)

    logged.poll()

    assert not logged.log.is_active
    logged.is_wanted = True
    logged.poll()
    starts = [one for one in list_records(logged.messages) if isinstance(one, LogStart)]
    assert [(one.origin, one.epoch) for one in starts] == [("bodies", 1)]
    assert logged.messages[0].sequence == 0


def test_nothing_is_noted_without_a_subscriber() -> None:
    logged = LoggedWorld("mujoco", is_fresh=False)
    logged.is_wanted = False
    engine = logged.world.engine
    logged.poll()
    logged.spawn_robots(1)
    logged.step(8)
    logged.poll()

    assert logged.world.engine is engine
    assert not logged.log.is_active
    assert logged.messages == []


def test_layer_is_removed_with_the_last_subscriber() -> None:
    logged = LoggedWorld("mujoco", is_fresh=False)
    engine = logged.world.engine
    logged.poll()
    assert logged.world.engine is not engine
    first = logged.messages[-1].log
    logged.is_wanted = False
    logged.poll()
    assert logged.world.engine is engine
    logged.is_wanted = True
    logged.poll()

    assert logged.messages[-1].log != first
    assert logged.messages[-1].sequence == 0


def test_log_from_the_start_waits_for_a_subscriber(tmp_path: Path) -> None:
    logged = LoggedWorld("mujoco")
    logged.is_wanted = False
    logged.spawn_robots(1)
    logged.step(8)
    assert logged.messages == []
    logged.is_wanted = True
    logged.step(8)

    result = resim(logged.messages, tmp_path)

    assert (result.is_exact, result.is_equal, result.steps) == (True, True, 16)


def test_bits_of_each_number_change_the_sum_of_their_entity() -> None:
    counts = np.array([1, 0, 2])
    draws = np.random.default_rng(1)
    base, joints = draws.normal(size=(3, 13)), draws.normal(size=(2, 3))
    summer = StateSummer(counts)
    before = summer.sum(BodyStates(base, *joints))
    owners = [0, 2, 2]

    for place in np.ndindex(3, 13):
        moved = base.copy()
        moved[place] = np.nextafter(moved[place], 9.0)
        after = summer.sum(BodyStates(moved, *joints))
        assert (after != before).tolist() == [row == place[0] for row in range(3)]
    for kind, joint in np.ndindex(2, 3):
        moved = joints.copy()
        moved[kind, joint] = np.nextafter(moved[kind, joint], 9.0)
        after = summer.sum(BodyStates(base, *moved))
        assert (after != before).tolist() == [row == owners[joint] for row in range(3)]


def test_requests_are_noted_with_their_step() -> None:
    logged = LoggedWorld("mujoco")
    logged.step(4)
    logged.log.note_request("delete_entity", "me", DeleteEntityRequest("r1"), 2, "no such entity")
    logged.poll()

    (request,) = [one for message in logged.messages for one in message.requests]
    assert (request.step, request.service, request.client) == (4, "delete_entity", "me")
    assert msgspec.json.decode(request.request)["entity"] == "r1"
    assert (request.code, request.message) == (2, "no such entity")


def test_log_has_an_end_when_its_server_ends(busy: LoggedWorld, tmp_path: Path) -> None:
    whole = resim(busy.messages, tmp_path)
    cut = resim(busy.messages[:-1], tmp_path)

    assert (whole.open_ends, cut.open_ends) == (0, 1)


def test_second_log_after_one_without_an_end_is_noted(busy: LoggedWorld, tmp_path: Path) -> None:
    second = [msgspec.structs.replace(one, log="second") for one in busy.messages]

    assert resim([*busy.messages[:-1], *second], tmp_path).open_ends == 1


HUGE = 1 << 40


def change_records(
    messages: Sequence[Inputs], kind: type[AnyRecord], change: Callable[[Any], AnyRecord]
) -> list[Inputs]:
    """Change the first record of a kind."""
    changed, is_done = [], False
    for message in messages:
        records = list(read_records(message.records)) if message.records else []
        for place, record in enumerate(records):
            if isinstance(record, kind) and not is_done:
                records[place], is_done = change(record), True
        (data,) = list(write_records(records)) or [b""]
        changed.append(msgspec.structs.replace(message, records=data))
    assert is_done
    return changed


def replacing(**fields: object) -> Callable[[Any], AnyRecord]:
    return lambda record: msgspec.structs.replace(record, **fields)


def with_recipe(**fields: object) -> Callable[[Any], AnyRecord]:
    return lambda record: msgspec.structs.replace(
        record, recipe=msgspec.structs.replace(record.recipe, **fields)
    )


@pytest.mark.parametrize(
    ("kind", "change"),
    [
        (LoggedRoster, lambda one: replacing(joint_counts=(HUGE,) * len(one.bodies))(one)),
        (LoggedRoster, lambda one: replacing(joint_counts=(-1,) * len(one.bodies))(one)),
        (LoggedRoster, lambda one: replacing(names=one.names[:-1])(one)),
        (LoggedRoster, replacing(frozen=(HUGE,))),
        (LoggedRoster, replacing(bodies=(HUGE,), joint_counts=(0,), names=("r",))),
        (StateSums, replacing(sums=b"\0")),
        (RecordedState, replacing(base=b"")),
        (RecordedState, replacing(positions=b"\0" * 8)),
        (Steps, replacing(count=HUGE)),
        (Steps, replacing(count=-1)),
        (LogStart, with_recipe(control_steps=0)),
        (LogStart, with_recipe(step_ns=0)),
        (LogStart, with_recipe(step_ns=HUGE)),
        (Add, replacing(model=99)),
        (Add, replacing(base=b"\0" * 8)),
        (CommandGroup, replacing(number=99)),
        (Command, replacing(group=99)),
    ],
)
def test_records_that_do_not_agree_are_refused(
    busy: LoggedWorld, tmp_path: Path, kind: type[AnyRecord], change: Callable[[Any], AnyRecord]
) -> None:
    messages = change_records(busy.messages, kind, change)

    with pytest.raises(ResimRefused) as refused:
        resim(messages, tmp_path)

    assert refused.value.slug == "resim.malformed"


@pytest.mark.parametrize("head", [b"\xdd", b"\xdd\0\0\0\1\xdd"], ids=["records", "fields"])
def test_count_that_the_bytes_do_not_have_is_refused(
    busy: LoggedWorld, tmp_path: Path, head: bytes
) -> None:
    data = head + b"\xff\xff\xff\xff"
    first = msgspec.structs.replace(busy.messages[0], records=data)

    with pytest.raises(ResimRefused) as refused:
        resim([first], tmp_path)

    assert refused.value.slug == "resim.malformed"


class RefusingEngine(ObedientEngine):
    """An engine that accepts no model."""

    def add(self, model: Model, base: FloatArray) -> int:
        raise EngineRefused(f"{model.name} is refused at {base[:3]}")


def test_model_that_both_engines_refused_is_not_reported() -> None:
    target = CallTarget(RefusingEngine(EngineConfig(4_000_000)))
    target.models[1] = BOX

    target.add(1, np.zeros(13), REFUSED)

    assert target.refusals == {}
