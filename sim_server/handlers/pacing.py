"""How time is made to pass: steps that are asked for, runs to a time, speed."""

from zensim.proto.messages import simulation_messages
from zensim.proto.messages.result_messages import Result, ResultCode
from zensim.proto.messages.simulation_messages import StepSimulationRequest, StepSimulationResponse
from zensim.proto.messages.standard_messages import NANOSECONDS, ns_from_time, time_from_ns
from zensim.sim_server.desk import Desk
from zensim.sim_server.errors import IncorrectState, Refused
from zensim.sim_server.later import Later
from zensim.sim_server.pacing.stepping import Goal

MAX_STEPS = 10_000_000
MAX_GOALS = 64
"""Goals that wait at a time."""
MIN_SPEED, MAX_SPEED = 0.01, 1000.0


def step(desk: Desk, request: StepSimulationRequest) -> Later:
    """Make steps of a paused world, and answer when the agents have answered the last."""
    goal = _add_goal(desk, request.steps)
    return Later(lambda: goal.is_over, lambda: StepSimulationResponse(_result_of(goal)))


def simulate_steps(desk: Desk, request: simulation_messages.SimulateStepsRequest) -> Later:
    """Make steps of a paused world, tell of their progress, and answer at the end."""
    goal_id = _checked_goal_id(request.goal_id)
    goal = desk.stepping.known(goal_id)
    if goal is None:
        goal = _add_goal(desk, request.steps, goal_id)
    elif goal.steps != request.steps:
        raise Refused(
            ResultCode.OPERATION_FAILED,
            f"goal {goal_id!r} has {goal.steps} steps; choose another id, or ask for those steps",
        )
    return Later(lambda: goal.is_over, lambda: _simulated(goal))


def cancel_steps(
    desk: Desk, request: simulation_messages.CancelStepsRequest
) -> simulation_messages.CancelStepsResponse:
    """End a goal, or all, before the last step."""
    canceled = desk.stepping.cancel(request.goal_id)
    if not canceled and request.goal_id:
        known = desk.stepping.known(request.goal_id)
        raise Refused(
            ResultCode.NOT_FOUND if known is None else ResultCode.INCORRECT_STATE,
            f"goal {request.goal_id[:80]!r} {'is unknown' if known is None else 'is over'}; "
            "nothing was canceled",
        )
    return simulation_messages.CancelStepsResponse(
        goal_ids=tuple(goal.goal_id for goal in canceled)
    )


def run_to(desk: Desk, request: simulation_messages.RunToRequest) -> Later:
    """Make steps of a paused world until a time is reached; a reset meanwhile ends the run."""
    world = desk.world
    if desk.stepping:
        raise IncorrectState("steps that were asked for before wait; try again when they are made")
    wanted_ns, epoch = ns_from_time(request.time), world.epoch
    if wanted_ns < world.time_ns:
        raise Refused(
            ResultCode.OPERATION_FAILED,
            f"{wanted_ns / NANOSECONDS:g} s is past: it is {world.time_ns / NANOSECONDS:g} s; "
            "reset to go back",
        )
    steps = -((world.time_ns - wanted_ns) // world.step_ns)
    goal = _add_goal(desk, steps, least=0)

    def is_over() -> bool:
        if world.epoch != epoch:
            desk.stepping.abort_one(goal, "the simulation was reset, and time went back")
        return goal.is_over

    return Later(
        is_over,
        lambda: simulation_messages.RunToResponse(
            _result_of(goal), time_from_ns(world.time_ns), goal.made
        ),
    )


def set_speed(
    desk: Desk, request: simulation_messages.SetSpeedRequest
) -> simulation_messages.SetSpeedResponse:
    """Choose the real-time factor to hold."""
    factor = request.real_time_factor
    if not (factor == 0.0 or MIN_SPEED <= factor <= MAX_SPEED):
        raise Refused(
            ResultCode.OPERATION_FAILED,
            f"real_time_factor={factor:g} is out of range; use 0 (flat out) or {MIN_SPEED:g} "
            f"to {MAX_SPEED:g}",
        )
    desk.target_real_time_factor = factor
    return simulation_messages.SetSpeedResponse()


def _add_goal(desk: Desk, steps: int, goal_id: str = "", *, least: int = 1) -> Goal:
    desk.world.require_paused()
    if not least <= steps <= MAX_STEPS:
        raise Refused(
            ResultCode.OPERATION_FAILED,
            f"steps={steps} is out of range; use {least} to {MAX_STEPS}",
        )
    if len(desk.stepping) >= MAX_GOALS:
        raise IncorrectState(f"{MAX_GOALS} goals wait already; try again when one is over")
    return desk.stepping.add(steps, goal_id)


def _checked_goal_id(goal_id: str) -> str:
    if len(goal_id) <= simulation_messages.MAX_GOAL_ID_LENGTH and goal_id.isprintable():
        return goal_id
    raise Refused(
        ResultCode.OPERATION_FAILED,
        f"goal_id {goal_id[:80]!r} is not valid; use at most {simulation_messages.MAX_GOAL_ID_LENGTH} printable "
        "characters",
    )


def _simulated(goal: Goal) -> simulation_messages.SimulateStepsResponse:
    return simulation_messages.SimulateStepsResponse(
        _result_of(goal), goal.goal_id, goal.status, goal.made, goal.left
    )


def _result_of(goal: Goal) -> Result:
    if goal.status == "canceled":
        text = f"canceled after {goal.made} of {goal.steps} steps"
        return Result(ResultCode.OPERATION_FAILED, text)
    if goal.status == "aborted":
        text = f"ended after {goal.made} of {goal.steps} steps: {goal.reason}"
        return Result(ResultCode.OPERATION_FAILED, text)
    if goal.late:
        names = ", ".join(sorted(goal.late))
        return Result(ResultCode.OK, f"not all steps were answered in time by: {names}")
    return Result()
