"""Sensor processes: publish scene states to them, and wait for their replies in lockstep."""

import logging
from collections.abc import Iterable

import msgspec

from zensim.proto.codec.message_codec import MalformedPayload, decode
from zensim.proto.keys import parse_sensor_process
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.sensing_messages import SceneState, SensorsReply
from zensim.proto.messages.sensor_messages import CameraSensor, RaySensor
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.network_protocols import Sample
from zensim.proto.sensor_libraries import parse_missing
from zensim.proto.sensor_schedule import is_due
from zensim.proto.topic_catalog import SCENE_STATE
from zensim.sim_server.runtime.loop_channels import Inbox, WorldPublisher
from zensim.sim_server.service_parts import ServerParts, make_environment

LOG = logging.getLogger(__name__)
CLIENT_PREFIX = "sensors/"
"""Prefix of the names of sensor processes among clients of `Lockstep`; agents have no slash."""
MAX_BUSY_NS = NANOSECONDS
"""Wall time for which a reply holds back later states while simulation time runs fast."""


class SceneStateReference(msgspec.Struct, frozen=True):
    """A scene state that was published, as `Lockstep` records it."""

    epoch: int
    step: int
    is_awaited: bool = False
    claims: bytes = b""
    order: int = 0


class SensorSessions:
    """Publishes the poses of all entities whenever a sensor of a sensor process may be due."""

    def __init__(self, parts: ServerParts, inbox: Inbox, publisher: WorldPublisher) -> None:
        self._world = parts.world
        self._current = parts.current_world
        self._pacing = parts.pacing
        self._processes = parts.sensors
        self._inbox = inbox
        self._publisher = publisher
        self._rates: tuple[int, frozenset[float]] = (-1, frozenset())
        """Distinct rates of sensors [Hz], of a roster number."""
        self._last: SceneState | None = None
        self._owed_since_ns: dict[str, int] = {}
        """Wall time of a state that a process has not replied to, by process."""

    def serve(self) -> None:
        """Handle liveliness changes, then replies."""
        for process, is_alive in self._inbox.take_sensor_processes():
            if is_alive:
                self._processes.active.add(process)
            else:
                self._forget(process)
        for process, text, is_alive in self._inbox.take_sensor_libraries():
            self._processes.note_missing(process, parse_missing(text), is_alive=is_alive)
        if self._processes.active:
            for sample in self._inbox.take_sensor_replies():
                self._take_reply(sample)

    def publish_state(self) -> None:
        """Publish the state of a control step if a sensor is due and there is a subscriber.

        When simulation time runs faster than wall time, it is left out while a process is busy.
        """
        if not self._publisher.is_wanted(SCENE_STATE) or not self._is_any_due():
            return
        now_ns = self._pacing.now_ns()
        if not self._pacing.is_paced and self._is_any_busy(now_ns):
            return
        self._last = self._make_state()
        self._publisher.publish(SCENE_STATE, self._last)
        sent = SceneStateReference(self._last.epoch, self._last.step, self._last.is_awaited)
        for process in self._last.processes:
            self._owed_since_ns[process] = now_ns
            client = CLIENT_PREFIX + process
            if not self._pacing.lockstep.record_sent(client, sent, now_ns):
                self._pacing.step_goals.note_late((client,))

    def publish_again(self, late: Iterable[str]) -> None:
        """Publish the last state again if one of these clients is a sensor process."""
        if self._last is not None and any(one.startswith(CLIENT_PREFIX) for one in late):
            self._publisher.publish(SCENE_STATE, self._last)

    def _make_state(self) -> SceneState:
        world, states = self._world, self._world.states()
        return SceneState(
            epoch=world.clock.epoch,
            step=world.clock.steps,
            time_ns=world.clock.time_ns,
            roster=world.entities.roster_number,
            poses=states.base[:, :7].tobytes(),
            joint_positions=states.joint_positions.tobytes(),
            processes=tuple(sorted(self._processes.active)),
            is_awaited=self._pacing.is_awaited,
            topic_faults=world.injected_faults.topic_faults,
        )

    def _is_any_due(self) -> bool:
        roster = self._world.entities.roster_number
        if self._rates[0] != roster:
            self._rates = roster, find_sensor_rates(one.model for one in self._world.entities)
        step, environment = self._world.clock.steps, make_environment(self._world, self._current)
        return any(is_due(step, rate_hz, environment) for rate_hz in self._rates[1])

    def _is_any_busy(self, now_ns: int) -> bool:
        return any(now_ns - since_ns < MAX_BUSY_NS for since_ns in self._owed_since_ns.values())

    def _take_reply(self, sample: Sample) -> None:
        process = parse_sensor_process(sample.key)
        try:
            reply = decode(SensorsReply, sample.payload, sample.encoding)
        except MalformedPayload as error:
            LOG.debug("reply dropped sensors=%s reason=%s", process, error)
            return
        if process in self._processes.active:
            self._owed_since_ns.pop(process, None)
            self._processes.replies[process] = reply
            reference = SceneStateReference(reply.epoch, reply.step)
            self._pacing.lockstep.record_answer(CLIENT_PREFIX + process, reference)

    def _forget(self, process: str) -> None:
        self._processes.active.discard(process)
        self._processes.replies.pop(process, None)
        self._owed_since_ns.pop(process, None)
        self._pacing.lockstep.forget(CLIENT_PREFIX + process)


def find_sensor_rates(models: Iterable[Model]) -> frozenset[float]:
    """Find the distinct rates [Hz] of the sensors that sensor processes publish."""
    # By identity: entities of one description share a model, and hashing models is slow.
    distinct = {id(model): model for model in models}
    return frozenset(
        sensor.update_rate_hz
        for model in distinct.values()
        for sensor in model.sensors
        if isinstance(sensor.settings, RaySensor | CameraSensor)
    )
