"""Services of Gazebo classic, and their refusals."""

import math

import msgspec
import numpy as np
import pytest

from tests.engines import STEP_NS
from tests.models import a_body, a_box, a_state, an_arm
from tests.sim_server.fakes import a_spawn, a_world, handle_request, make_parts, names_in
from zensim.proto.messages import gazebo_messages
from zensim.proto.messages.gazebo_messages import GazeboEntityState, JointType, ODEJointProperties
from zensim.proto.messages.model_messages import Inertial
from zensim.proto.messages.result_messages import ResultCode
from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.standard_messages import (
    Duration,
    Point,
    Pose,
    Quaternion,
    Time,
    Twist,
    Vector3,
    Wrench,
    ns_from_time,
)
from zensim.proto.service_catalog import SERVICES
from zensim.sim_server.errors import SimError
from zensim.sim_server.runtime.world_telemetry import make_link_states, make_model_states
from zensim.sim_server.service_parts import ServerParts
from zensim.sim_server.services.service_registry import make_refusal

DT_S = STEP_NS * 1e-9
HALF = math.sqrt(0.5)
LEFT = (0.0, 0.0, math.pi / 2.0)
"""A quarter turn."""
FOR_EVER = Duration(-1)


@pytest.fixture
def parts() -> ServerParts:
    """A box that faces along y, and an arm."""
    world = a_world()
    world.spawn(a_spawn("box", model=a_box(), base=a_state((1.0, 2.0, 0.5), turn=LEFT)))
    world.spawn(a_spawn("arm", model=an_arm("revolute"), base=a_state((5.0, 0.0, 0.0))))
    world.clock.take_events()
    return make_parts(world)


def a_push(link: str = "box::base", **changes: object) -> gazebo_messages.ApplyLinkWrenchRequest:
    force = Wrench(Vector3(2.0, 0.0, 0.0))
    plain = gazebo_messages.ApplyLinkWrenchRequest(link, wrench=force, duration=FOR_EVER)
    return msgspec.structs.replace(plain, **changes)


def gained(parts: ServerParts, request: gazebo_messages.ApplyLinkWrenchRequest) -> list[float]:
    """Apply a wrench for a step; return the change of each velocity per newton [m/s^2]."""
    report = handle_request(parts, request)
    assert isinstance(report, gazebo_messages.ApplyLinkWrenchReport)
    assert report.success
    before = parts.world.state_of("box").copy()
    parts.world.step()
    change: list[float] = ((parts.world.state_of("box") - before)[7:] / DT_S).tolist()
    return change


def test_time_is_paused_and_played_repeatedly(parts: ServerParts) -> None:
    for request, state in (
        (gazebo_messages.PausePhysicsRequest(), State.PAUSED),
        (gazebo_messages.UnpausePhysicsRequest(), State.PLAYING),
    ):
        assert handle_request(parts, request) == gazebo_messages.EmptyReport()
        assert handle_request(parts, request) == gazebo_messages.EmptyReport()
        assert parts.world.clock.state == state


def test_world_is_reset_without_its_time(parts: ServerParts) -> None:
    parts.world.place("box", a_state((9.0, 9.0, 9.0)))
    parts.world.step()

    handle_request(parts, gazebo_messages.ResetWorldRequest())

    assert parts.world.state_of("box")[:3] == pytest.approx([1.0, 2.0, 0.5])
    assert (parts.world.clock.steps, names_in(parts.world)) == (1, ["box", "arm"])


def test_simulation_is_reset_with_its_time_and_keeps_what_was_spawned(parts: ServerParts) -> None:
    parts.world.place("box", a_state((9.0, 9.0, 9.0)))
    parts.world.step()

    handle_request(parts, gazebo_messages.GazeboResetSimulationRequest())

    assert parts.world.state_of("box")[:3] == pytest.approx([1.0, 2.0, 0.5])
    assert (parts.world.clock.time_ns, names_in(parts.world)) == (0, ["box", "arm"])


def test_models_are_listed_with_simulation_time(parts: ServerParts) -> None:
    parts.world.step()

    report = handle_request(parts, gazebo_messages.GetModelListRequest())

    assert isinstance(report, gazebo_messages.GetModelListReport)
    assert (report.success, report.model_names) == (True, ("box", "arm"))
    assert ns_from_time(report.header.stamp) == parts.world.clock.time_ns > 0


def test_state_is_returned_in_the_frame_of_another_entity(parts: ServerParts) -> None:
    parts.world.place("box", a_state((1.0, 2.0, 0.5), turn=LEFT, linear=(1.0, 0.0, 0.0)))
    parts.world.place("arm", a_state((1.0, 3.0, 0.5), linear=(1.0, 1.0, 0.0)))

    report = handle_request(parts, gazebo_messages.GazeboGetEntityStateRequest("arm", "box"))

    assert isinstance(report, gazebo_messages.GazeboGetEntityStateReport)
    assert report.success
    assert (report.header.frame_id, report.state.reference_frame) == ("box", "box")
    at, go = report.state.pose.position, report.state.twist.linear
    assert (at.x, at.y, at.z) == pytest.approx((1.0, 0.0, 0.0), abs=1e-9)
    assert (go.x, go.y, go.z) == pytest.approx((1.0, 0.0, 0.0), abs=1e-9)


def test_state_of_a_link_is_returned_in_the_world(parts: ServerParts) -> None:
    report = handle_request(parts, gazebo_messages.GazeboGetEntityStateRequest("arm::arm"))

    assert isinstance(report, gazebo_messages.GazeboGetEntityStateReport)
    states = make_link_states(parts.world)
    place = states.name.index("arm::arm")
    assert (report.state.pose, report.state.twist) == (states.pose[place], states.twist[place])
    assert report.header.frame_id == "world"


def test_entity_is_placed_in_the_frame_of_another(parts: ServerParts) -> None:
    pose = Pose(Point(1.0, 0.0, 0.0), Quaternion())
    state = GazeboEntityState("arm", pose, Twist(Vector3(1.0)), "box")

    assert handle_request(parts, gazebo_messages.GazeboSetEntityStateRequest(state)) == (
        gazebo_messages.GazeboSetEntityStateReport(success=True)
    )

    row = parts.world.state_of("arm")
    assert row[:3] == pytest.approx([1.0, 3.0, 0.5])
    assert row[7:10] == pytest.approx([0.0, 1.0, 0.0], abs=1e-12)


def test_wrench_without_a_frame_acts_at_the_centre_of_mass_in_the_world(parts: ServerParts) -> None:
    assert gained(parts, a_push())[:3] == pytest.approx([2.0, 0.0, 0.0])


def test_wrench_is_turned_with_its_frame_and_keeps_its_direction(parts: ServerParts) -> None:
    assert gained(parts, a_push(reference_frame="box"))[:3] == pytest.approx([0.0, 2.0, 0.0])
    parts.world.place("box", a_state((1.0, 2.0, 0.5)))
    parts.world.step()
    parts.world.step()
    assert parts.world.state_of("box")[8] == pytest.approx(4.0 * DT_S)


def test_wrench_beside_the_centre_of_mass_turns_the_link(parts: ServerParts) -> None:
    moment = a_body().inertia[5]

    change = gained(parts, a_push(reference_point=Point(0.0, 0.5, 0.0)))

    assert change[3:] == pytest.approx([0.0, 0.0, -1.0 / moment])


def test_wrench_at_a_point_of_a_frame_turns_the_link_by_its_arm(parts: ServerParts) -> None:
    moment = a_body().inertia[5]
    at_origin = a_push(reference_frame="box::base")

    assert gained(parts, at_origin)[3:] == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)
    parts.world.applied_forces.forget_all()
    aside = a_push(reference_frame="box::base", reference_point=Point(0.0, 0.5, 0.0))
    assert gained(parts, aside)[5] == pytest.approx(-1.0 / moment)


def test_wrench_of_no_duration_does_nothing(parts: ServerParts) -> None:
    report = handle_request(parts, a_push(duration=Duration()))

    assert isinstance(report, gazebo_messages.ApplyLinkWrenchReport)
    assert (report.success, len(parts.world.applied_forces)) == (True, 0)


def test_wrench_begins_and_ends_in_simulation_time(parts: ServerParts) -> None:
    begin = Time(0, 10 * STEP_NS)
    handle_request(parts, a_push(start_time=begin, duration=Duration(0, 5 * STEP_NS)))

    speeds = []
    for _ in range(20):
        parts.world.step()
        speeds.append(float(parts.world.state_of("box")[7]))

    assert speeds[9] == 0.0
    assert speeds[-1] == speeds[14] == pytest.approx(10.0 * DT_S)


def test_wrenches_are_cleared_by_link(parts: ServerParts) -> None:
    handle_request(parts, a_push())

    handle_request(parts, gazebo_messages.ClearLinkWrenchesRequest("arm::arm"))
    assert len(parts.world.applied_forces) == 1
    handle_request(parts, gazebo_messages.ClearLinkWrenchesRequest("box::base"))
    assert len(parts.world.applied_forces) == 0


def test_effort_is_applied_to_a_joint_by_either_name_and_cleared(parts: ServerParts) -> None:
    for name in ("swing", "arm::swing"):
        request = gazebo_messages.ApplyJointEffortRequest(name, 0.5, duration=FOR_EVER)
        report = handle_request(parts, request)
        assert isinstance(report, gazebo_messages.ApplyJointEffortReport)
        assert report.success
    parts.world.step()

    assert parts.world.states().joint_velocities[0] == pytest.approx(DT_S)
    handle_request(parts, gazebo_messages.ClearJointEffortsRequest("swing"))
    assert len(parts.world.applied_forces) == 0


def test_joint_properties_are_set_and_returned(parts: ServerParts) -> None:
    wanted = ODEJointProperties(damping=(0.3,), lo_stop=(-0.1,), hi_stop=(0.2,), fmax=(0.05,))
    number = parts.world.entities.roster_number

    handle_request(parts, gazebo_messages.SetJointPropertiesRequest("swing", wanted))

    report = handle_request(parts, gazebo_messages.GetJointPropertiesRequest("arm::swing"))
    assert report == gazebo_messages.GetJointPropertiesReport(
        JointType.REVOLUTE,
        damping=(0.3,),
        position=(0.0,),
        rate=(0.0,),
        success=True,
        lower=(-0.1,),
        upper=(0.2,),
        friction=(0.05,),
    )
    assert parts.world.entities.roster_number > number


def test_entity_keeps_its_state_when_its_model_changes(parts: ServerParts) -> None:
    parts.world.claim("a", ("arm",), "stop")
    parts.world.place("arm", a_state((3.0, 0.0, 0.0), linear=(1.0, 0.0, 0.0)), np.array([0.3]))
    before = parts.world.state_of("arm").copy()

    handle_request(
        parts,
        gazebo_messages.SetJointPropertiesRequest("swing", ODEJointProperties(damping=(0.3,))),
    )

    assert parts.world.state_of("arm") == pytest.approx(before)
    assert parts.world.states().joint_positions[-1] == pytest.approx(0.3)
    assert parts.world.claims.agent_of("arm") == "a"


def test_link_properties_are_set_and_returned(parts: ServerParts) -> None:
    found = handle_request(parts, gazebo_messages.GetLinkPropertiesRequest("box::base"))
    assert isinstance(found, gazebo_messages.GetLinkPropertiesReport)
    assert (found.mass, found.izz, found.gravity_mode) == (1.0, 0.01, True)

    com = Pose(Point(0.1, 0.0, 0.0), Quaternion(0.0, 0.0, HALF, HALF))
    request = gazebo_messages.SetLinkPropertiesRequest(
        "box::base", com, gravity_mode=False, mass=4.0, ixx=0.1, iyy=0.2, izz=0.25
    )
    handle_request(parts, request)

    again = handle_request(parts, gazebo_messages.GetLinkPropertiesRequest("box::base"))
    assert isinstance(again, gazebo_messages.GetLinkPropertiesReport)
    assert (again.mass, again.gravity_mode, again.com.position.x) == (4.0, False, 0.1)
    assert (again.ixx, again.iyy, again.izz) == pytest.approx((0.2, 0.1, 0.25))
    link = parts.world.entities.find("box").model.links[0]
    assert link.weightless == link.inertial != Inertial()


def test_topics_contain_every_entity_and_every_link(parts: ServerParts) -> None:
    models, links = make_model_states(parts.world), make_link_states(parts.world)

    assert models.name == ("box", "arm")
    assert links.name == ("box::base", "arm::post", "arm::arm")
    assert models.pose[0] == links.pose[0]
    assert models.pose[0].position == Point(1.0, 2.0, 0.5)
    assert len(links.pose) == len(links.twist) == 3


REFUSED = {
    "push nobody": (a_push("nobody::link"), ResultCode.NOT_FOUND, "'nobody'"),
    "push an entity": (a_push("box"), ResultCode.NOT_FOUND, "'box::base'"),
    "push no link": (a_push("arm::leg"), ResultCode.NOT_FOUND, "'arm::post', 'arm::arm'"),
    "push in no frame": (a_push(reference_frame="moon"), ResultCode.NOT_FOUND, "frame 'moon'"),
    "push with no number": (
        a_push(wrench=Wrench(Vector3(math.nan))),
        ResultCode.OPERATION_FAILED,
        "force nan",
    ),
    "push too hard": (
        a_push(wrench=Wrench(torque=Vector3(1e9))),
        ResultCode.OPERATION_FAILED,
        r"torque 1e\+09",
    ),
    "push far away": (
        a_push(reference_point=Point(math.inf)),
        ResultCode.OPERATION_FAILED,
        "reference_point inf",
    ),
    "turn no joint": (
        gazebo_messages.ApplyJointEffortRequest("knee", 1.0),
        ResultCode.NOT_FOUND,
        "'knee'",
    ),
    "turn no joint of one": (
        gazebo_messages.ApplyJointEffortRequest("arm::knee", 1.0),
        ResultCode.NOT_FOUND,
        "'arm::swing'",
    ),
    "turn what has none": (
        gazebo_messages.ClearJointEffortsRequest("box::knee"),
        ResultCode.NOT_FOUND,
        "'box'",
    ),
    "turn by no number": (
        gazebo_messages.ApplyJointEffortRequest("swing", math.inf),
        ResultCode.OPERATION_FAILED,
        "effort inf",
    ),
    "tell nobody's state": (
        gazebo_messages.GazeboGetEntityStateRequest("nobody"),
        ResultCode.NOT_FOUND,
        "'nobody'",
    ),
    "tell no link's state": (
        gazebo_messages.GazeboGetEntityStateRequest("arm::leg"),
        ResultCode.NOT_FOUND,
        "'arm::leg'",
    ),
    "put a hanging link": (
        gazebo_messages.GazeboSetEntityStateRequest(GazeboEntityState("arm::arm")),
        ResultCode.OPERATION_FAILED,
        "'arm::arm'.*'arm'",
    ),
    "set ODE's solver": (
        gazebo_messages.SetJointPropertiesRequest("swing", ODEJointProperties(erp=(0.2,))),
        ResultCode.FEATURE_UNSUPPORTED,
        "erp.*'swing'",
    ),
    "damp two axes": (
        gazebo_messages.SetJointPropertiesRequest("swing", ODEJointProperties(damping=(0.2, 0.1))),
        ResultCode.OPERATION_FAILED,
        "damping",
    ),
    "damp below zero": (
        gazebo_messages.SetJointPropertiesRequest("swing", ODEJointProperties(damping=(-1.0,))),
        ResultCode.OPERATION_FAILED,
        "damping -1",
    ),
    "cross the limits": (
        gazebo_messages.SetJointPropertiesRequest("swing", ODEJointProperties(lo_stop=(2.0,))),
        ResultCode.OPERATION_FAILED,
        "lo_stop 2.*'swing'.*hi_stop 0.5",
    ),
    "weigh nothing": (
        gazebo_messages.SetLinkPropertiesRequest("box::base"),
        ResultCode.OPERATION_FAILED,
        "mass 0",
    ),
    "weigh a moment below zero": (
        gazebo_messages.SetLinkPropertiesRequest("box::base", mass=1.0, ixx=-1.0),
        ResultCode.OPERATION_FAILED,
        "inertia",
    ),
}


@pytest.mark.parametrize(("request_", "code", "named"), REFUSED.values(), ids=REFUSED)
def test_request_is_refused(
    parts: ServerParts, request_: msgspec.Struct, code: int, named: str
) -> None:
    before = parts.world.states().base.tobytes()

    with pytest.raises(SimError, match=named) as refused:
        handle_request(parts, request_)

    assert refused.value.code == code
    assert parts.world.states().base.tobytes() == before
    assert len(parts.world.applied_forces) == 0


def test_joint_that_several_entities_have_is_named_in_full(parts: ServerParts) -> None:
    parts.world.spawn(a_spawn("other", model=an_arm("revolute"), base=a_state((9.0, 0.0, 0.0))))

    with pytest.raises(SimError, match="'arm::swing', 'other::swing'"):
        handle_request(parts, gazebo_messages.ApplyJointEffortRequest("swing", 1.0))


GAZEBO = [
    name
    for name, one in SERVICES.items()
    if one.request.__module__ == "zensim.proto.messages.gazebo_messages"
]


@pytest.mark.parametrize("name", GAZEBO)
def test_refusal_sets_success_and_result(name: str) -> None:
    response_ = make_refusal(name, ResultCode.NOT_FOUND, "nobody is there")

    assert response_.result.result == ResultCode.NOT_FOUND  # type: ignore[attr-defined]
    assert getattr(response_, "success", False) is False
    assert getattr(response_, "status_message", "nobody is there") == "nobody is there"
