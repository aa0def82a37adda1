"""The loop: requests, commands, physics, telemetry, in this order; paced to a real-time factor.

One thread owns world and engine. While it waits for the next step's deadline it polls its inbox, so
that a request between steps is answered at once.
"""

import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import msgspec

from proto.bus import Call
from proto.catalog import SERVICES
from proto.claims import DriveCommand
from proto.codec import Format, MalformedPayload, decode, encode, encoding_of, format_of
from proto.keys import agent_of
from proto.keys import service as service_key
from proto.result import ResultCode
from proto.services import SpawnEntityOrder, State, StepSimulationRequest
from sim_server.answers import Answer, Answers
from sim_server.desk import Desk
from sim_server.errors import SimError
from sim_server.handlers import handle, refusal
from sim_server.inbox import Inbox
from sim_server.outlets import Outlet
from sim_server.telemetry import TOPICS, Telemetry

LOG = logging.getLogger(__name__)

POLL_S = 0.0003
IDLE_POLL_S = 0.001
MAX_LAG_NS = 50_000_000
"""How far the loop may run behind and still catch up; beyond, the deadline slips."""


class Clock(Protocol):
    """Wall time."""

    def now_ns(self) -> int:
        """Monotonic time."""

    def sleep(self, seconds: float) -> None:
        """Wait."""


@dataclass
class _Waiting:
    """A spawn whose description is being read."""

    call: Call
    order: SpawnEntityOrder


@dataclass
class _Stepping:
    """A request whose steps are being made; a reset sets time back, not what is left."""

    left: int
    call: Call
    response: msgspec.Struct


class Loop:
    """Drives one world."""

    def __init__(self, desk: Desk, inbox: Inbox, outlet: Outlet, clock: Clock) -> None:
        self._desk = desk
        self._world = desk.world
        self._meter = desk.meter
        self._inbox = inbox
        self._outlet = outlet
        self._clock = clock
        self._telemetry = Telemetry(desk.world, desk.meter)
        self._deadline_ns = clock.now_ns()
        self._answers = Answers()
        self._stepping: list[_Stepping] = []
        self._waiting: list[_Waiting] = []

    def run(self, should_stop: Callable[[], bool]) -> None:
        """Go on until told to stop."""
        while not should_stop():
            self.turn()

    def turn(self) -> None:
        """Serve what has come, then step if it is time, else wait a little."""
        self.serve()
        now_ns = self._clock.now_ns()
        if self._stepping:
            self._requested_step(now_ns)
        elif self._world.state != State.PLAYING:
            self._deadline_ns = now_ns
            self._clock.sleep(IDLE_POLL_S)
        elif now_ns >= self._deadline_ns:
            self.tick(now_ns)
            self._set_deadline()
        else:
            self._clock.sleep(min(POLL_S, (self._deadline_ns - now_ns) * 1e-9))
        self.publish()

    def serve(self) -> None:
        """Take in everything that has come."""
        # Calls are taken before tokens and answered after them: an agent's token comes first.
        calls = self._inbox.take_calls()
        for agent, is_alive in self._inbox.take_agents():
            self._note_agent(agent, is_alive=is_alive)
        self._note_bonds()
        for sample in self._inbox.take_commands():
            self._command(agent_of(sample.key), sample.payload, sample.encoding)
        for call in calls:
            self._meter.requests += 1
            self._answer(call)
        if self._desk.descriptions.poll():
            self._carry_on()

    def tick(self, now_ns: int) -> None:
        """Advance by one step and tell the agents."""
        self._world.step()
        took_ns = self._clock.now_ns() - now_ns
        self._meter.note_step(
            simulated_ns=self._world.step_ns,
            took_ns=took_ns,
            late_ns=max(0, now_ns - self._deadline_ns),
        )
        if self._world.is_control_step:
            self._tell_agents()

    def publish(self) -> None:
        """Tell everybody what is due."""
        for event in self._world.take_events():
            LOG.info(
                "event kind=%s entity=%s agent=%s message=%s",
                event.kind,
                event.entity,
                event.agent,
                event.message,
            )
            self._outlet.tell("events", event)
        now_ns = self._clock.now_ns()
        if self._meter.close_window(now_ns) and self._outlet.is_wanted("stats"):
            self._outlet.tell("stats", self._telemetry.stats())
        for topic in self._telemetry.due(now_ns):
            if self._outlet.is_wanted(topic):
                self._outlet.tell(topic, self._telemetry.message(topic))

    def _tell_agents(self) -> None:
        for agent, state in self._world.drive_states():
            self._outlet.tell_agent(agent, state)

    def _set_deadline(self) -> None:
        factor = self._desk.target_real_time_factor
        now_ns = self._clock.now_ns()
        if factor <= 0.0:
            self._deadline_ns = now_ns
            return
        self._deadline_ns += round(self._world.step_ns / factor)
        if (lag_ns := now_ns - self._deadline_ns) > MAX_LAG_NS:
            self._meter.slipped_ns += lag_ns
            self._deadline_ns = now_ns

    def _requested_step(self, now_ns: int) -> None:
        self._deadline_ns = now_ns
        self.tick(now_ns)
        first = self._stepping[0]
        first.left -= 1
        if first.left == 0:
            self._stepping.pop(0)
            self._reply(first.call, first.response)

    def _note_agent(self, agent: str, *, is_alive: bool) -> None:
        if is_alive:
            self._desk.alive_agents.add(agent)
            return
        self._desk.alive_agents.discard(agent)
        self._world.release(agent)
        self._outlet.forget_agent(agent)

    def _note_bonds(self) -> None:
        for bond, is_alive in self._inbox.take_bonds():
            if is_alive:
                self._desk.alive_bonds.add(bond)
            else:
                self._desk.end_bond(bond)

    def _command(self, agent: str, payload: bytes, encoding: str) -> None:
        try:
            command = decode(DriveCommand, payload, encoding)
        except MalformedPayload as error:
            self._world.claims.dropped += 1
            LOG.debug("drive command dropped agent=%s reason=%s", agent, error)
            return
        if self._world.command(agent, command):
            self._world.note_ready(agent, self._clock.now_ns())

    def _answer(self, call: Call) -> None:
        if call.name in TOPICS:
            self._reply(call, self._telemetry.message(call.name))
        elif (answer := self._answers.known(call)) is not None:
            self._send(call, answer)
        elif not self._joins_waiting(call):
            self._carry_out(call)

    def _joins_waiting(self, call: Call) -> bool:
        """Let a retry take the place of a request that is still being carried out."""
        everybody: list[_Stepping | _Waiting] = [*self._stepping, *self._waiting]
        for waiting in everybody:
            if call.request_id and waiting.call.request_id == call.request_id:
                waiting.call = call
                return True
        return False

    def _carry_out(self, call: Call) -> None:
        try:
            request = decode(_request_type(call.name), call.payload, call.encoding)
            if self._must_wait(call, request):
                return
            response = handle(self._desk, request)
        except SimError as error:
            response = refusal(call.name, error.code, str(error))
        except MalformedPayload as error:
            response = refusal(
                call.name, ResultCode.OPERATION_FAILED, f"malformed request: {error}"
            )
        else:
            if isinstance(request, StepSimulationRequest):
                self._stepping.append(_Stepping(request.steps, call, response))
                return
        self._reply(call, response)

    def _must_wait(self, call: Call, request: msgspec.Struct) -> bool:
        if not isinstance(request, SpawnEntityOrder) or self._desk.descriptions.is_read(request):
            return False
        self._waiting.append(_Waiting(call, request))
        return True

    def _carry_on(self) -> None:
        """Spawn what has been read meanwhile, in the order of asking."""
        for waiting in self._waiting[:]:
            if self._desk.descriptions.is_read(waiting.order):
                self._waiting.remove(waiting)
                self._reply(waiting.call, self._outcome(waiting.call.name, waiting.order))

    def _outcome(self, name: str, request: msgspec.Struct) -> msgspec.Struct:
        try:
            return handle(self._desk, request)
        except SimError as error:
            return refusal(name, error.code, str(error))

    def _reply(self, call: Call, response: msgspec.Struct) -> None:
        wanted = _reply_format(call)
        try:
            payload = encode(response, wanted)
        except TypeError:
            # A response that CDR cannot express, such as a claim with its model.
            wanted = Format.MSGPACK
            payload = encode(response, wanted)
        answer = Answer(payload, encoding_of(response, wanted))
        self._answers.keep(call, answer)
        self._send(call, answer)

    def _send(self, call: Call, answer: Answer) -> None:
        call.reply(answer.payload, answer.encoding, service_key(self._world.name, call.name))


def _request_type(name: str) -> type[msgspec.Struct]:
    if (service := SERVICES.get(name)) is None:
        raise SimUnknown(name)
    return service.request


class SimUnknown(SimError):
    """A service that no server offers."""

    code = ResultCode.FEATURE_UNSUPPORTED

    def __init__(self, name: str) -> None:
        super().__init__(f"service {name[:80]!r} is unknown; there are {', '.join(SERVICES)}")


def _reply_format(call: Call) -> Format:
    try:
        return format_of(call.payload, call.encoding)
    except MalformedPayload:
        return Format.JSON if "json" in call.encoding else Format.MSGPACK
