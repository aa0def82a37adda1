"""Services that control the simulation: state, steps, speed, reset; and server information."""

from dataclasses import replace
from importlib.metadata import version

import msgspec

from zensim.proto.codec.cdr_reader import MalformedPayload
from zensim.proto.messages import simulation_messages, telemetry_messages
from zensim.proto.messages.agent_messages import TwistCommands
from zensim.proto.messages.result_messages import Result, ResultCode, SetSimulationStateCode
from zensim.proto.messages.simulation_messages import (
    GetSimulationStateRequest,
    GetSimulationStateResponse,
    ResetScope,
    ResetSimulationRequest,
    ResetSimulationResponse,
    SetSimulationStateRequest,
    SetSimulationStateResponse,
    SimulationState,
    State,
    StepSimulationRequest,
    StepSimulationResponse,
)
from zensim.proto.messages.standard_messages import NANOSECONDS, ns_from_time, time_from_ns
from zensim.sim_server.errors import (
    IncorrectState,
    RequestRefused,
    SimError,
    SteppedByOther,
    UnsupportedFeature,
)
from zensim.sim_server.pacing.joined_clients import MAX_JOINED, JoinedState
from zensim.sim_server.pacing.step_goals import StepGoal
from zensim.sim_server.service_parts import CurrentWorld, DeferredResponse, Pacing, StepMode
from zensim.sim_server.world.simulated_world import SimulatedWorld
from zensim.sim_server.world.simulation_clock import (
    ALLOWED_TRANSITIONS,
    STATE_NAMES,
    explain_refused_transition,
)

VERSION = version("zensim")


def get_server_info(
    world: SimulatedWorld, current: CurrentWorld, pacing: Pacing, _: telemetry_messages.InfoRequest
) -> telemetry_messages.Info:
    """Return the server's version, configuration and state."""
    is_playing = world.clock.state == State.PLAYING
    return telemetry_messages.Info(
        world=world.name,
        version=VERSION,
        protocol=telemetry_messages.PROTOCOL,
        sim_time_s=world.clock.time_ns * 1e-9,
        steps=world.clock.steps,
        epoch=world.clock.epoch,
        step_ns=world.clock.step_ns,
        real_time_factor=pacing.loop_stats.real_time_factor if is_playing else 0.0,
        target_real_time_factor=pacing.target_real_time_factor,
        entities=len(world.entities),
        agents=world.claims.agent_count,
        claimed=len(world.claims),
        state=world.clock.state_name,
        engine=world.engine.name,
        world_model=current.model.name,
        seed=current.seed,
        is_lockstep=pacing.lockstep.settings.lockstep,
        driven=world.claims.driven,
    )


MAX_STEPS = 10_000_000
MAX_GOALS = 64
"""Most active goals."""
MIN_SPEED, MAX_SPEED = 0.01, 1000.0


def step_simulation(
    world: SimulatedWorld, pacing: Pacing, request: StepSimulationRequest
) -> DeferredResponse[StepSimulationResponse]:
    """Step a paused world; reply when the agents have replied to the last step."""
    _require_lease(pacing)
    goal = _add_goal(world, pacing, request.steps)
    return DeferredResponse(
        lambda: goal.is_over, lambda: StepSimulationResponse(_make_goal_result(goal))
    )


def simulate_steps(
    world: SimulatedWorld, pacing: Pacing, request: simulation_messages.SimulateStepsRequest
) -> DeferredResponse[simulation_messages.SimulateStepsResponse]:
    """Step a paused world, publish progress, and reply at the end.

    A client with a liveliness token becomes the only one that steps; a world that plays is paused.
    """
    goal_id = _check_goal_id(request.goal_id)
    _take_lease(world, pacing, request.client)
    goal = pacing.step_goals.find(goal_id)
    if goal is None and request.twists is not None:
        _order_twists(world, request.twists)
    if goal is None:
        goal = _add_goal(world, pacing, request.steps, goal_id)
    elif goal.steps != request.steps:
        raise RequestRefused(
            ResultCode.OPERATION_FAILED,
            f"goal {goal_id!r} has {goal.steps} steps; use another id, or the same number of steps",
        )
    factor = pacing.loop_stats.real_time_factor

    def respond() -> simulation_messages.SimulateStepsResponse:
        response = _make_steps_response(goal)
        if not request.wants_snapshot or goal.status != "succeeded":
            return response
        return msgspec.structs.replace(response, snapshot=world.snapshot(factor))

    goal.is_eager = request.is_eager
    return DeferredResponse(lambda: goal.is_over, respond)


def join_lockstep(
    world: SimulatedWorld, pacing: Pacing, request: simulation_messages.JoinLockstepRequest
) -> DeferredResponse[simulation_messages.JoinLockstepResponse]:
    """Finish the client's present control step; reply at its next one, and await it from then on.

    Time does not advance from then until its next request, by the rules for agents.
    """
    if request.client not in pacing.lease.alive:
        raise _make_tokenless(request.client)
    period = request.steps or world.control_steps
    if period % world.control_steps or period > MAX_STEPS:
        raise RequestRefused(
            ResultCode.OPERATION_FAILED,
            f"steps={period} is no multiple of the {world.control_steps} steps between two control "
            f"steps; use {world.control_steps}, {2 * world.control_steps}, …",
        )
    if request.client not in pacing.joined and len(pacing.joined) >= MAX_JOINED:
        raise IncorrectState(f"{MAX_JOINED} clients have joined; try again when one has ended")
    if request.twists is not None:
        _order_twists(world, request.twists)
    done = JoinedState(request.epoch, request.step)
    joined = pacing.joined.finish(request.client, period, done)
    wakes, factor = joined.wakes, pacing.loop_stats.real_time_factor

    def respond() -> simulation_messages.JoinLockstepResponse:
        if joined.is_gone:
            gone = Result(ResultCode.INCORRECT_STATE, f"client {request.client!r} is gone")
            return simulation_messages.JoinLockstepResponse(gone)
        return simulation_messages.JoinLockstepResponse(snapshot=world.snapshot(factor))

    return DeferredResponse(lambda: joined.is_gone or joined.wakes != wakes, respond)


def _make_tokenless(client: str) -> IncorrectState:
    return IncorrectState(
        f"client '{client[:80]}' has no liveliness token; declare it before stepping"
    )


def _require_lease(pacing: Pacing, client: str = "") -> None:
    if other := pacing.lease.find_other(client):
        raise SteppedByOther(other)


def _take_lease(world: SimulatedWorld, pacing: Pacing, client: str) -> None:
    _require_lease(pacing, client)
    if not client:
        return
    if client not in pacing.lease.alive:
        raise _make_tokenless(client)
    mode = StepMode(world.clock.state, pacing.target_real_time_factor)
    pacing.lease.take(client, mode)
    if world.clock.state == State.PLAYING:
        world.clock.pause()


def _order_twists(world: SimulatedWorld, commands: TwistCommands) -> None:
    try:
        world.commanded_twists.order(world.entities.index, commands)
    except MalformedPayload as error:
        raise RequestRefused(ResultCode.OPERATION_FAILED, f"twists: {error}") from error


def cancel_steps(
    pacing: Pacing, request: simulation_messages.CancelStepsRequest
) -> simulation_messages.CancelStepsResponse:
    """Cancel one goal, or all."""
    canceled = pacing.step_goals.cancel(request.goal_id)
    if not canceled and request.goal_id:
        known = pacing.step_goals.find(request.goal_id)
        raise RequestRefused(
            ResultCode.NOT_FOUND if known is None else ResultCode.INCORRECT_STATE,
            f"goal {request.goal_id[:80]!r} {'is unknown' if known is None else 'has ended'}; "
            "nothing was canceled",
        )
    return simulation_messages.CancelStepsResponse(
        goal_ids=tuple(goal.goal_id for goal in canceled)
    )


def run_to(
    world: SimulatedWorld, pacing: Pacing, request: simulation_messages.RunToRequest
) -> DeferredResponse[simulation_messages.RunToResponse]:
    """Step a paused world until a simulation time; a reset aborts the run."""
    _require_lease(pacing)
    if pacing.step_goals:
        raise IncorrectState("other step requests are active; try again when they have ended")
    wanted_ns, epoch = ns_from_time(request.time), world.clock.epoch
    if wanted_ns < world.clock.time_ns:
        raise RequestRefused(
            ResultCode.OPERATION_FAILED,
            f"time {wanted_ns / NANOSECONDS:g} s is before the current time "
            f"{world.clock.time_ns / NANOSECONDS:g} s; use a later time, or reset first",
        )
    steps = -((world.clock.time_ns - wanted_ns) // world.clock.step_ns)
    goal = _add_goal(world, pacing, steps, least=0)

    def is_over() -> bool:
        if world.clock.epoch != epoch:
            pacing.step_goals.abort_goal(goal, "the simulation was reset")
        return goal.is_over

    return DeferredResponse(
        is_over,
        lambda: simulation_messages.RunToResponse(
            _make_goal_result(goal), time_from_ns(world.clock.time_ns), goal.completed
        ),
    )


def set_speed(
    pacing: Pacing, request: simulation_messages.SetSpeedRequest
) -> simulation_messages.SetSpeedResponse:
    """Set the target real-time factor."""
    factor = request.real_time_factor
    if not (factor == 0.0 or MIN_SPEED <= factor <= MAX_SPEED):
        raise RequestRefused(
            ResultCode.OPERATION_FAILED,
            f"real_time_factor={factor:g} is out of range; "
            f"use 0 (as fast as possible) or {MIN_SPEED:g} "
            f"to {MAX_SPEED:g}",
        )
    pacing.target_real_time_factor = factor
    pacing.lease.revise(lambda mode: replace(mode, real_time_factor=factor))
    return simulation_messages.SetSpeedResponse()


def _add_goal(
    world: SimulatedWorld, pacing: Pacing, steps: int, goal_id: str = "", *, least: int = 1
) -> StepGoal:
    world.clock.require_paused()
    if not least <= steps <= MAX_STEPS:
        raise RequestRefused(
            ResultCode.OPERATION_FAILED,
            f"steps={steps} is out of range; use {least} to {MAX_STEPS}",
        )
    if len(pacing.step_goals) >= MAX_GOALS:
        raise IncorrectState(f"{MAX_GOALS} goals are active; try again when one has ended")
    return pacing.step_goals.add(steps, goal_id)


def _check_goal_id(goal_id: str) -> str:
    if len(goal_id) <= simulation_messages.MAX_GOAL_ID_LENGTH and goal_id.isprintable():
        return goal_id
    raise RequestRefused(
        ResultCode.OPERATION_FAILED,
        f"goal_id {goal_id[:80]!r} is not valid; use at most "
        f"{simulation_messages.MAX_GOAL_ID_LENGTH} printable characters",
    )


def _make_steps_response(goal: StepGoal) -> simulation_messages.SimulateStepsResponse:
    return simulation_messages.SimulateStepsResponse(
        _make_goal_result(goal), goal.goal_id, goal.status, goal.completed, goal.remaining
    )


def _make_goal_result(goal: StepGoal) -> Result:
    if goal.status == "canceled":
        text = f"canceled after {goal.completed} of {goal.steps} steps"
        return Result(ResultCode.OPERATION_FAILED, text)
    if goal.status == "aborted":
        text = f"ended after {goal.completed} of {goal.steps} steps: {goal.reason}"
        return Result(ResultCode.OPERATION_FAILED, text)
    if goal.late:
        names = ", ".join(sorted(goal.late))
        return Result(ResultCode.OK, f"these agents did not reply to all steps in time: {names}")
    return Result()


def reset_simulation(
    world: SimulatedWorld, request: ResetSimulationRequest
) -> ResetSimulationResponse:
    """Reset time, states and spawned entities, as the scope says."""
    known = ResetScope.TIME | ResetScope.STATE | ResetScope.SPAWNED
    if request.scope not in (ResetScope.ALL, request.scope & known):
        raise UnsupportedFeature(
            f"scope {request.scope} has unknown bits; use 0, 255 or a sum of 1, 2, 4"
        )
    world.reset(request.scope)
    return ResetSimulationResponse()


def get_simulation_state(
    world: SimulatedWorld, _: GetSimulationStateRequest
) -> GetSimulationStateResponse:
    """Return the state of the simulation."""
    return GetSimulationStateResponse(SimulationState(world.clock.state))


def set_simulation_state(
    world: SimulatedWorld, pacing: Pacing, request: SetSimulationStateRequest
) -> SetSimulationStateResponse:
    """Change the state: play, pause, stop or quit."""
    wanted, present = request.state.state, world.clock.state
    if {wanted, present} <= {State.PLAYING, State.PAUSED}:
        # Also where stepping has paused it already: this request outlasts the lease.
        pacing.lease.revise(lambda mode: replace(mode, state=State(wanted)))
    if wanted == present:
        raise RequestRefused(
            SetSimulationStateCode.ALREADY_IN_TARGET_STATE,
            f"the simulation is {world.clock.state_name} already",
        )
    if wanted not in ALLOWED_TRANSITIONS[present]:
        raise RequestRefused(
            SetSimulationStateCode.INCORRECT_TRANSITION, explain_refused_transition(wanted, present)
        )
    if wanted in (State.STOPPED, State.QUITTING):
        pacing.step_goals.abort(f"the simulation is {STATE_NAMES[State(wanted)]}")
    if wanted == State.STOPPED:
        _reset_to_start(world)
    world.clock.change_state(State(wanted))
    return SetSimulationStateResponse()


def _reset_to_start(world: SimulatedWorld) -> None:
    try:
        world.reset(ResetScope.ALL)
    except SimError as error:
        raise RequestRefused(SetSimulationStateCode.STATE_TRANSITION_ERROR, str(error)) from error
