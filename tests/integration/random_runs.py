"""Runs in free running, with commands and requests over the network at random instants."""

import random
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from itertools import pairwise

import msgspec
import numpy as np

from tests.integration.processes import Server, eventually, serving
from zensim.proto import keys
from zensim.proto.bus.bus_session import Bus
from zensim.proto.codec.message_codec import Format, decode, encode, make_encoding
from zensim.proto.engine_proofs import EngineName
from zensim.proto.messages.agent_messages import ClaimEntityRequest, DriveCommand, DriveState
from zensim.proto.messages.entity_messages import EntityState
from zensim.proto.messages.input_messages import Inputs
from zensim.proto.messages.spawn_messages import Resource, SpawnEntityOrder
from zensim.proto.messages.standard_messages import Point, Pose, PoseStamped
from zensim.proto.service_catalog import CLAIM_ENTITY
from zensim.proto.topic_catalog import DRIVE_COMMAND, DRIVE_STATE, INPUTS
from zensim.sim_server.input_log.input_records import StateSums, read_records, write_records
from zensim.sim_server.physics.engine_calls import Command, Steps
from zensim.spawner.client.sim_client import SimClient

WORLD, AGENT = "default", "random"
ROBOTS = 6
SPREAD_M = 1.2
"""Half the side of the square that robots share, so that they collide."""
WITHIN_S = 60.0
DEPTH = 1 << 16
MAX_CHANGES = 5
STEPS_PER_S = 240
MAX_SPEED = 12.0
"""Of wheels [rad/s]."""


@dataclass(frozen=True)
class RandomRun:
    """What a run has published, and how many inputs it was given."""

    messages: tuple[Inputs, ...]
    inputs: int


def change_command(messages: Sequence[Inputs], after_step: int) -> tuple[list[Inputs], int]:
    """Change one byte of the first command after a step: turn a wheel back.

    Returns:
        The messages, and the control step at which the states first differ.
    """
    changed, next_step = list(messages), 0
    for place, message in enumerate(messages):
        if message.step <= after_step or not message.records:
            continue
        records = list(read_records(message.records))
        if not next_step:
            at = next((n for n, pair in enumerate(pairwise(records)) if _acts(*pair)), None)
            if at is None:
                continue
            command = records[at]
            assert isinstance(command, Command)
            targets = bytearray(command.targets)
            targets[7] ^= 0x80
            records[at] = Command(command.group, bytes(targets))
            (data,) = write_records(records)
            changed[place] = msgspec.structs.replace(message, records=data)
            records, next_step = records[at:], -1
        if next_step < 0:
            sums = (one.step for one in records if isinstance(one, StateSums))
            next_step = next(sums, next_step)
    return changed, next_step


def find_change(
    messages: Sequence[Inputs], find_difference: Callable[[Sequence[Inputs]], int | None]
) -> tuple[int, int]:
    """Change one byte of a command in the middle of a run, and find where the states part.

    A motor with its greatest torque may have it with another target, too; if nothing differs within
    a second, a later command is changed.

    Args:
        messages: Of the run.
        find_difference: Runs messages again, and returns the step of the first difference.

    Returns:
        Control step at which the change may act first, and that of the first difference.

    Raises:
        LookupError: No change made a difference.
    """
    after = messages[-1].step // 2
    for _ in range(MAX_CHANGES):
        changed, step = change_command(messages, after)
        end = step + STEPS_PER_S
        found = find_difference([one for one in changed if one.step <= end])
        if found is not None:
            return step, found
        # The first command of a message may be of an earlier step than the message.
        after = next(one.step for one, now in zip(messages, changed, strict=True) if one is not now)
    raise LookupError(f"no difference after {MAX_CHANGES} changes of commands")


def _acts(record: object, following: object) -> bool:
    """Whether a record is a command with new targets that a physics step follows."""
    return isinstance(record, Command) and bool(record.targets) and isinstance(following, Steps)


class RandomAgent:
    """An agent that commands random wheel speeds."""

    def __init__(self, bus: Bus, names: tuple[str, ...], draws: random.Random) -> None:
        self._draws = draws
        self._states = bus.subscribe(DRIVE_STATE.key(WORLD, AGENT))
        encoding = make_encoding(DriveCommand, Format.MSGPACK)
        self._commands = bus.advertise(DRIVE_COMMAND.key(WORLD, AGENT), encoding)
        self._state: DriveState | None = None
        self.token = bus.token(keys.alive_agent(WORLD, AGENT))
        request = ClaimEntityRequest(AGENT, names)
        eventually(lambda: self._claim(bus, request), WITHIN_S, "claims")
        eventually(self.command, WITHIN_S, "drive states")

    def command(self) -> bool:
        """Command all robots; False before the first state."""
        for sample in self._states.take():
            self._state = decode(DriveState, sample.payload, sample.encoding)
        if (state := self._state) is None or not state.claims:
            return False
        count = 2 * len(np.frombuffer(state.claims, "<u4"))
        speeds = [self._draws.uniform(-MAX_SPEED, MAX_SPEED) for _ in range(count)]
        targets = np.array(speeds, dtype="<f8").tobytes()
        command = DriveCommand(state.epoch, state.step, state.claims, targets)
        self._commands.send(encode(command, Format.MSGPACK))
        return True

    def _claim(self, bus: Bus, request: ClaimEntityRequest) -> bool:
        try:
            bus.call(CLAIM_ENTITY, request, world=WORLD)
        except Exception:  # noqa: BLE001  the token is not known yet
            return False
        return True


def make_random_run(engine: EngineName, *, seconds: float, seed: int) -> RandomRun:
    """Run a server with the log of its inputs, and take what it publishes.

    Args:
        engine: Of the world.
        seconds: Wall time of the inputs.
        seed: Of their kinds and numbers; instants depend on the machine.
    """
    with ExitStack() as stack:
        server = stack.enter_context(serving("--engine", engine, "--input-log"))
        log = server.bus.subscribe(INPUTS.key(WORLD), DEPTH)
        messages: list[Inputs] = []
        count = 0
        for _ in make_random_inputs(server, seconds, random.Random(seed)):
            count += 1
            messages += [decode(Inputs, one.payload, one.encoding) for one in log.take()]
        steps = server.steps()

        def has_all() -> bool:
            messages.extend(decode(Inputs, one.payload, one.encoding) for one in log.take())
            return messages[-1].step > steps

        eventually(has_all, WITHIN_S, "the last messages")
    return RandomRun(tuple(messages), count)


def make_random_inputs(server: Server, seconds: float, draws: random.Random) -> Iterator[None]:
    """Drive, spawn, delete and place robots for a wall time; yield after each input."""
    names = tuple(f"r{number}" for number in range(ROBOTS))
    for number, name in enumerate(names):
        server.client.spawn(make_order(name, 0.5 * (number % 3), 0.5 * (number // 3)))
    agent = RandomAgent(server.bus, names, draws)
    with closing(agent.token):
        extra, end_s = 0, time.monotonic() + seconds
        while time.monotonic() < end_s:
            time.sleep(draws.uniform(0.0, 0.02))
            extra += _make_input(server.client, agent, draws, extra)
            yield


def make_order(name: str, x: float, y: float) -> SpawnEntityOrder:
    """Make the request of a robot at a place [m]."""
    pose = PoseStamped(pose=Pose(Point(x, y, 0.06)))
    return SpawnEntityOrder(name, entity_resource=Resource("box_bot"), initial_pose=pose)


def _make_input(client: SimClient, agent: RandomAgent, draws: random.Random, extra: int) -> int:
    """Make one input; return how many more robots there are."""
    x, y = draws.uniform(-SPREAD_M, SPREAD_M), draws.uniform(-SPREAD_M, SPREAD_M)
    chance = draws.random()
    if chance < 0.9:
        agent.command()
    elif chance < 0.94:
        state = EntityState(pose=Pose(Point(x, y, 0.1)))
        client.set_entity_state(f"r{draws.randrange(ROBOTS)}", state)
    elif chance < 0.97 or not extra:
        client.spawn(make_order(f"extra{extra}", x, y))
        return 1
    else:
        client.delete(f"extra{extra - 1}")
        return -1
    return 0
