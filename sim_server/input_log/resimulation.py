"""Resimulation: runs the engine again with the inputs of a log, and compares the states."""

from collections.abc import Iterable
from functools import singledispatchmethod
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from zensim.proto.engine_proofs import EngineName
from zensim.proto.messages.input_messages import Inputs
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.state_hash import hash_states
from zensim.sim_server.input_log.input_records import (
    FORMAT,
    AnyRecord,
    EngineRecipe,
    LogEnd,
    LoggedRoster,
    LogStart,
    PresentBody,
    RecordedState,
    StateSummer,
    StateSums,
    StoredMesh,
    find_versions,
    read_records,
)
from zensim.sim_server.input_log.state_comparison import (
    COLUMNS,
    Distance,
    StateDifference,
    compare_states,
    list_joints,
    measure_distance,
)
from zensim.sim_server.physics.engine import BodyStates
from zensim.sim_server.physics.engine_calls import (
    REFUSED,
    Add,
    ApplyJointEffort,
    ApplyLinkWrench,
    CallTarget,
    Command,
    EngineCall,
    Remove,
    SetAtRest,
    SetBaseState,
    SetState,
    Steps,
    read_floats,
    write_floats,
)
from zensim.sim_server.physics.engine_config import choose_engine, find_installed_engines

FLOAT_BYTES, SUM_BYTES = 8, 4
DISAGREEMENTS: Final = (ValueError, LookupError, TypeError, ArithmeticError)
"""Errors of a record that contradicts those before it: unknown bodies or models, wrong sizes."""
MAX_SHOWN: Final = 8
"""Entities and inputs that a difference lists."""
COUNTED: Final = (
    *(Add, Remove, SetBaseState, SetAtRest, SetState),
    *(Command, ApplyLinkWrench, ApplyJointEffort),
)
"""Calls that are inputs; others prepare them."""


class ResimRefused(ValueError):
    """A log cannot be run again; `slug` identifies the reason for programs."""

    def __init__(self, message: str, *, slug: str) -> None:
        self.slug = slug
        super().__init__(f"{slug}: {message}")


class MalformedRecords(ValueError):
    """Numbers of a log do not agree with each other."""


def require_size(data: bytes, size: int) -> None:
    """Check the size of an array.

    Raises:
        MalformedRecords: It has another one.
    """
    if len(data) != size:
        raise MalformedRecords(f"an array has {len(data)} bytes, and its entities {size}")


class ResimChanges(msgspec.Struct, frozen=True, kw_only=True):
    """What differs from the recorded run; None = as it was."""

    engine: EngineName | None = None
    step_ns: int | None = None
    gravity: tuple[float, float, float] | None = None
    ground_friction: float | None = None
    only_compares: bool = False
    """Whether equal states are not expected, though nothing is changed."""
    allow_failed_engine: bool = False

    @property
    def is_exact(self) -> bool:
        """Whether equal states are expected."""
        return msgspec.structs.replace(self, allow_failed_engine=False) == ResimChanges()

    def apply_to(self, recipe: EngineRecipe) -> EngineRecipe:
        """Change how an engine is made."""
        options = recipe.options
        if self.engine is not None:
            options = msgspec.structs.replace(options, engine=self.engine)
        if self.allow_failed_engine:
            options = msgspec.structs.replace(options, allow_failed_engine=True)
        step_ns = self.step_ns or recipe.step_ns
        friction = self.ground_friction
        return msgspec.structs.replace(
            recipe,
            options=options,
            control_steps=max(1, round(recipe.control_steps * recipe.step_ns / step_ns)),
            step_ns=step_ns,
            gravity=self.gravity or recipe.gravity,
            ground_friction=recipe.ground_friction if friction is None else friction,
        )


class FirstDifference(msgspec.Struct, frozen=True, kw_only=True):
    """Where a run first differs from the recorded one."""

    step: int
    """First control step with other states; the one before had equal ones."""
    time_s: float
    """Simulation time."""
    entities: tuple[str, ...]
    """First of the entities whose states differ there."""
    count: int
    """Number of entities whose states differ there."""
    inputs: tuple[str, ...]
    """Last inputs before that step, since the control step before."""
    measured_s: float | None = None
    """Simulation time of the next recorded states, by which differences are measured."""
    differences: tuple[StateDifference, ...] = ()
    """Differences, the greatest first."""


class ResimResult(msgspec.Struct, kw_only=True):
    """Result of a run."""

    engine: str = ""
    is_exact: bool = True
    """Whether equal states were expected."""
    steps: int = 0
    simulated_s: float = 0.0
    inputs: int = 0
    """Calls that changed the engine, besides steps."""
    control_steps: int = 0
    """Control steps whose states were compared."""
    states: int = 0
    """Times at which all numbers were compared, once a second."""
    equal_states: int = 0
    digest: str = ""
    """Hash of the last states that were compared, as it was computed here."""
    only_compares: bool = False
    """Whether distances were asked for, or an engine that differs."""
    lost_messages: int = 0
    """Messages that are not in the recording, as the numbers of those that are say."""
    skipped_messages: int = 0
    """Messages that were not run: no start was before them, or messages were lost since."""
    open_ends: int = 0
    """Logs without the end that their server writes: the recording ended first, or the server
    did not end in order."""
    cuts: tuple[str, ...] = ()
    """Why more of the log is missing at its end, as far as the recording shows it."""
    starts: int = 0
    """How often the run began: at the start, at worlds that were loaded, after lost messages."""
    refused_models: dict[str, str] = {}
    """Models that this engine refused, with its reason."""
    first_difference: FirstDifference | None = None
    distances: list[Distance] = []

    @property
    def is_equal(self) -> bool:
        """Whether states were compared bit by bit, all are equal, and nothing is known to miss."""
        return (
            self.is_exact
            and self.control_steps > 0
            and self.first_difference is None
            and self._is_whole
        )

    @property
    def is_passed(self) -> bool:
        """Whether the states are equal, or the distances that were asked for are known."""
        return self._is_whole if self.only_compares else self.is_equal

    @property
    def _is_whole(self) -> bool:
        return not self.lost_messages and not self.skipped_messages and not self.cuts


class RepeatedRun:
    """The engine from one start on, and what the log says of its entities."""

    def __init__(self, start: LogStart, recipe: EngineRecipe, folder: str) -> None:
        self.start = start
        self.recipe = recipe
        self.folder = folder
        self.roster = LoggedRoster((), (), (), ())
        self.summer = StateSummer(np.zeros(0, np.intp))
        self.own_steps = 0
        """Steps of this engine, which may be longer or shorter than recorded ones."""
        self.target = CallTarget(recipe.make(folder))
        self._steps = 0
        self._loads: list[EngineCall] = []

    def make_steps(self, count: int) -> None:
        """Make recorded steps; with another step size, as many as fit into their time."""
        if not self._has_other_steps:
            Steps(count).make_on(self.target)
            self.own_steps += count
            return
        for _ in range(count):
            self._steps += 1
            due = round(self._steps * self.start.recipe.step_ns / self.recipe.step_ns)
            for _ in range(due - self.own_steps):
                for load in self._loads:
                    load.make_on(self.target)
                self.target.engine.step()
            self.own_steps = due
            self._loads.clear()

    def apply_load(self, load: EngineCall) -> None:
        """Apply a force during the next recorded step."""
        if self._has_other_steps:
            self._loads.append(load)
        else:
            load.make_on(self.target)

    def set_roster(self, roster: LoggedRoster) -> None:
        """Set which entities the next states are of.

        Raises:
            MalformedRecords: Its numbers are not those of the bodies.
        """
        models = [self.target.model_of[body] for body in roster.bodies]
        counts = tuple(len(model.joints) for model in models)
        is_valid = len(roster.names) == len(counts) and roster.joint_counts == counts
        if not is_valid or not {*roster.frozen} <= {*range(len(counts))}:
            raise MalformedRecords("the numbers of a roster are not those of its bodies")
        self.roster = roster
        self.summer = StateSummer(np.array(roster.joint_counts, dtype=np.intp), roster.frozen)

    def read(self) -> tuple[BodyStates, list[int]]:
        """Read the states of the entities that this engine has, and list their places."""
        bodies = self.target.bodies
        present = [n for n, body in enumerate(self.roster.bodies) if body in bodies]
        own = tuple(bodies[self.roster.bodies[n]] for n in present)
        return self.target.engine.read(own), present

    def find_different(self, recorded: StateSums) -> list[int]:
        """List the places of the entities whose states differ from recorded ones."""
        states, present = self.read()
        count = len(self.roster.names)
        require_size(recorded.sums, count * SUM_BYTES)
        if len(present) < count:
            return sorted(set(range(count)) - set(present))
        known = np.frombuffer(recorded.sums, dtype="<u4")
        places: list[int] = np.flatnonzero(self.summer.sum(states) != known).tolist()
        return places

    def hash(self, recorded: RecordedState) -> str:
        """Hash the states of the entities, as the server did."""
        states, present = self.read()
        positions = states.joint_positions.copy()
        kept, start = read_floats(recorded.positions), 0
        for place, joints in zip(present, list_joints(self.roster, present), strict=True):
            if place in self.roster.frozen:
                positions[start : start + len(joints)] = kept[joints]
            start += len(joints)
        names = [self.roster.names[place] for place in present]
        return hash_states(
            recorded.time_ns, names, write_floats(states.base), write_floats(positions)
        )

    def close(self) -> None:
        """Free the engine."""
        self.target.engine.close()

    @property
    def _has_other_steps(self) -> bool:
        return self.recipe.step_ns != self.start.recipe.step_ns


class Resimulation:
    """Runs a log again, message by message."""

    def __init__(self, folder: Path, changes: ResimChanges) -> None:
        """Prepare.

        Args:
            folder: Empty; meshes are written there.
            changes: What differs from the recorded run.
        """
        self._folder = folder
        self._changes = changes
        is_exact = changes.is_exact
        self.result = ResimResult(is_exact=is_exact, only_compares=not is_exact)
        self._run: RepeatedRun | None = None
        self._log, self._next = "", 0
        self._goes_on = False
        """Whether the run goes on where the log offers a start: its bodies are left out."""
        self._recent: list[str] = []
        """Inputs since the last control step."""
        self._is_ended = True
        """Whether the present log has its end, or there is none yet."""

    @property
    def is_decided(self) -> bool:
        """Whether the first difference is known and measured."""
        first = self.result.first_difference
        return self.result.is_exact and first is not None and first.measured_s is not None

    def feed(self, message: Inputs) -> None:
        """Run a message of the log.

        Raises:
            ResimRefused: It is of another version, or damaged.
        """
        if message.log == self._log and message.sequence < self._next:
            return  # it is in two files of a recording
        if (message.log, message.sequence) != (self._log, self._next):
            self._note_gap(message)
        if message.log != self._log:
            self.result.open_ends += not self._is_ended
            self._is_ended = False
        self._log, self._next = message.log, message.sequence + 1
        try:
            records = read_records(message.records) if message.records else ()
        except msgspec.DecodeError as error:
            text = f"message {message.sequence} of the log is damaged, or of another version"
            raise ResimRefused(f"{text}: {error}", slug="resim.malformed") from error
        self._run_records(records)
        if self._run is None and records:
            self.result.skipped_messages += 1

    def _run_records(self, records: Iterable[AnyRecord]) -> None:
        for record in records:
            if isinstance(record, LogEnd):
                self._is_ended = True
            elif isinstance(record, LogStart):
                self._begin(record)
            elif self._run is not None:
                self._take_checked(record, self._run)

    def _take_checked(self, record: AnyRecord, run: RepeatedRun) -> None:
        try:
            self._take(record, run)
        except DISAGREEMENTS as error:
            text = f"message {self._next - 1} of the log is damaged: {type(record).__name__}"
            raise ResimRefused(
                f"{text}: {type(error).__name__}: {error}", slug="resim.malformed"
            ) from error

    def close(self) -> None:
        """Free the engine."""
        self._end_run()

    def finish(self, cuts: Iterable[str] = ()) -> ResimResult:
        """End the run.

        Args:
            cuts: Why the end of the log is missing, if that is known.

        Raises:
            ResimRefused: No log begins in the messages.
        """
        self._end_run()
        self.result.open_ends += not self._is_ended
        self._is_ended = True
        self.result.cuts = tuple(cuts)
        if not self.result.starts:
            raise ResimRefused(
                "no log of inputs begins in this recording; record with 'zensim up --record', or "
                "with 'zensim record --all'",
                slug="resim.no_start",
            )
        return self.result

    def _note_gap(self, message: Inputs) -> None:
        """Wait for the next start: messages are missing, or it is another log.

        Those before the first that is read may be in an earlier file of the recording.
        """
        if self._log:
            first = self._next if message.log == self._log else 0
            self.result.lost_messages += message.sequence - first
        self._end_run()

    def _begin(self, start: LogStart) -> None:
        """Begin a run; go on with the present one where the log only offers a start."""
        check_format(start)
        self._goes_on = start.origin != "fresh" and self._run is not None
        if self._goes_on:
            return
        if self._changes.is_exact:
            check_versions(start)
        self._end_run()
        recipe = self._changes.apply_to(start.recipe)
        self._run = RepeatedRun(start, recipe, str(self._folder))
        result = self.result
        result.starts += 1
        result.engine = choose_engine(recipe.options, find_installed_engines())
        result.is_exact &= start.origin == "fresh"

    def _end_run(self) -> None:
        if (run := self._run) is not None:
            self._run = None
            self.result.steps += run.own_steps
            self.result.simulated_s += run.own_steps * run.recipe.step_ns / NANOSECONDS
            run.close()

    @singledispatchmethod
    def _take(self, record: AnyRecord, run: RepeatedRun) -> None:
        """Make a call, or compare states."""
        assert isinstance(record, EngineCall)
        if isinstance(record, Add):
            require_size(record.base, COLUMNS * FLOAT_BYTES)
        self._note_input(record, run)
        record.make_on(run.target)
        if isinstance(record, Add):
            self._note_refusal(record, run)

    def _note_refusal(self, record: Add | PresentBody, run: RepeatedRun) -> None:
        """Note that this engine refuses a model that the other one accepted."""
        if (reason := run.target.refusals.get(record.body)) is not None:
            self.result.refused_models[run.target.models[record.model].name] = reason

    @_take.register
    def _(self, record: Steps, run: RepeatedRun) -> None:
        run.make_steps(record.count)

    @_take.register(ApplyLinkWrench)
    @_take.register(ApplyJointEffort)
    def _(self, record: EngineCall, run: RepeatedRun) -> None:
        self._note_input(record, run)
        run.apply_load(record)

    @_take.register
    def _(self, record: StoredMesh, run: RepeatedRun) -> None:
        Path(run.folder, Path(record.name).name).write_bytes(record.data)

    @_take.register
    def _(self, record: PresentBody, run: RepeatedRun) -> None:
        if self._goes_on:
            return
        require_size(record.base, COLUMNS * FLOAT_BYTES)
        run.target.add(record.model, read_floats(record.base), record.body)
        self._note_refusal(record, run)
        if (own := run.target.bodies.get(record.body)) is not None:
            joints = read_floats(record.positions), read_floats(record.velocities)
            run.target.engine.set_state(own, read_floats(record.base), *joints)
            if record.is_hidden:
                run.target.engine.hide(own)

    @_take.register
    def _(self, record: LoggedRoster, run: RepeatedRun) -> None:
        run.set_roster(record)

    @_take.register
    def _(self, record: StateSums, run: RepeatedRun) -> None:
        recent, self._recent = self._recent, []
        result = self.result
        if not result.is_exact or result.first_difference is not None:
            return
        result.control_steps += 1
        if places := run.find_different(record):
            names = [run.roster.names[place] for place in places]
            result.first_difference = FirstDifference(
                step=record.step,
                time_s=record.step * run.start.recipe.step_ns / NANOSECONDS,
                entities=tuple(names[:MAX_SHOWN]),
                count=len(names),
                inputs=tuple(recent[-MAX_SHOWN:]),
            )

    @_take.register
    def _(self, record: RecordedState, run: RepeatedRun) -> None:
        result, (states, present) = self.result, run.read()
        joints = sum(run.roster.joint_counts)
        require_size(record.base, len(run.roster.names) * COLUMNS * FLOAT_BYTES)
        require_size(record.positions, joints * FLOAT_BYTES)
        require_size(record.velocities, joints * FLOAT_BYTES)
        result.states += 1
        result.digest = run.hash(record)
        result.equal_states += result.digest == record.digest
        found = compare_states(states, present, record, run.roster)
        if not result.is_exact:
            if (distance := measure_distance(record, found)) is not None:
                result.distances.append(distance)
        elif (first := result.first_difference) is not None and first.measured_s is None:
            different = [one for one in found if not one.is_equal]
            different.sort(key=lambda one: (one.position_m, one.angle_rad), reverse=True)
            result.first_difference = msgspec.structs.replace(
                first,
                measured_s=record.time_ns / NANOSECONDS,
                differences=tuple(different[:MAX_SHOWN]),
            )

    def _note_input(self, call: EngineCall, run: RepeatedRun) -> None:
        if isinstance(call, COUNTED):
            self.result.inputs += 1
            self._recent.append(describe_call(call, run))


def describe_call(call: EngineCall, run: RepeatedRun) -> str:
    """Name a call and what it was for, by the entities of the last roster."""
    names = dict(zip(run.roster.bodies, run.roster.names, strict=True))
    kind = type(call).__name__
    if isinstance(call, Command):
        bodies = run.target.groups[call.group]
        first = names.get(bodies[0], f"body {bodies[0]}")
        return f"{kind} {first}" + (f" and {len(bodies) - 1} more" if len(bodies) > 1 else "")
    if isinstance(call, Add):
        return f"{kind} {run.target.models[call.model].name}"
    body = int(getattr(call, "body", REFUSED))
    return f"{kind} {names.get(body, f'body {body}')}"


def check_topic(name: str, first: str) -> None:
    """Refuse logs of several worlds, whose messages are between each other.

    Raises:
        ResimRefused: A message is of another topic than the first.
    """
    if name != first:
        raise ResimRefused(
            f"the recording has the logs {first} and {name}; make a recording of each world with "
            "'zensim bag convert --regex'",
            slug="resim.several_worlds",
        )


def check_format(start: LogStart) -> None:
    """Refuse records that this version does not know.

    Raises:
        ResimRefused: They are of another version.
    """
    if start.format != FORMAT:
        raise ResimRefused(
            f"the log has format {start.format}, this version reads {FORMAT}; "
            f"use zensim {start.versions.zensim}",
            slug="resim.other_version",
        )


def check_versions(start: LogStart) -> None:
    """Refuse a log whose bits this host cannot repeat.

    Raises:
        ResimRefused: A library, zensim or the processor is another.
    """
    engine = choose_engine(start.recipe.options, find_installed_engines())
    here = find_versions(engine)
    pairs = [(f, getattr(start.versions, f), getattr(here, f)) for f in here.__struct_fields__]
    wrong = [
        f"{name} was {theirs}, here it is {ours}" for name, theirs, ours in pairs if theirs != ours
    ]
    if wrong:
        raise ResimRefused(
            f"this host cannot repeat the bits of the recording: {'; '.join(wrong)}; "
            "use an equal installation, or `report` for how far trajectories part",
            slug="resim.other_version",
        )
