"""GazeboClient: a typed method for each service that keeps Gazebo's own name."""

from zensim.proto import service_catalog
from zensim.proto.bus import Bus
from zensim.proto.messages import gazebo_messages
from zensim.proto.messages.gazebo_messages import GazeboEntityState, ODEJointProperties
from zensim.proto.messages.standard_messages import NANOSECONDS, Duration, Point, Time, Wrench
from zensim.proto.service_catalog import Request, Response, Service

CALL_TIMEOUT_S = 10.0
FOREVER_S = -1.0
ORIGIN = Point()


class GazeboClient:
    """One world's Gazebo services; refusals raise ServiceError, silence TimeoutError or NoServer.

    Links and joints are named as Gazebo names them: `entity::link`. Times are of simulation.
    """

    def __init__(self, bus: Bus, world: str = "default", timeout_s: float = CALL_TIMEOUT_S) -> None:
        self.bus = bus
        self.world = world
        self._timeout_s = timeout_s

    def entity_state(self, name: str, reference_frame: str = "") -> GazeboEntityState:
        """Ask where an entity or a link is, in the world or another frame."""
        request = gazebo_messages.GazeboGetEntityStateRequest(name, reference_frame)
        return self._call(service_catalog.GAZEBO_GET_ENTITY_STATE, request).state

    def set_entity_state(self, state: GazeboEntityState) -> None:
        """Put an entity somewhere, in the frame that the state names."""
        request = gazebo_messages.GazeboSetEntityStateRequest(state)
        self._call(service_catalog.GAZEBO_SET_ENTITY_STATE, request)

    def pause_physics(self) -> None:
        """Let time stand."""
        self._call(service_catalog.PAUSE_PHYSICS, gazebo_messages.PausePhysicsRequest())

    def unpause_physics(self) -> None:
        """Let time run."""
        self._call(service_catalog.UNPAUSE_PHYSICS, gazebo_messages.UnpausePhysicsRequest())

    def reset_world(self) -> None:
        """Put every entity back where it was spawned; time goes on."""
        self._call(service_catalog.RESET_WORLD, gazebo_messages.ResetWorldRequest())

    def apply_link_wrench(
        self,
        link: str,
        wrench: Wrench,
        *,
        reference_frame: str = "",
        reference_point: Point = ORIGIN,
        start_s: float = 0.0,
        duration_s: float = FOREVER_S,
    ) -> str:
        """Push a link for a while, and return from when to when."""
        request = gazebo_messages.ApplyLinkWrenchRequest(
            link,
            reference_frame,
            reference_point,
            wrench,
            _to_time(start_s),
            _to_duration(duration_s),
        )
        return self._call(service_catalog.APPLY_LINK_WRENCH, request).status_message

    def clear_link_wrenches(self, link: str) -> None:
        """Push a link no more."""
        self._call(
            service_catalog.CLEAR_LINK_WRENCHES, gazebo_messages.ClearLinkWrenchesRequest(link)
        )

    def apply_joint_effort(
        self,
        joint: str,
        effort: float,
        *,
        start_s: float = 0.0,
        duration_s: float = FOREVER_S,
    ) -> str:
        """Push a joint [N m or N] for a while, and return from when to when."""
        request = gazebo_messages.ApplyJointEffortRequest(
            joint, effort, _to_time(start_s), _to_duration(duration_s)
        )
        return self._call(service_catalog.APPLY_JOINT_EFFORT, request).status_message

    def clear_joint_efforts(self, joint: str) -> None:
        """Push a joint no more."""
        self._call(
            service_catalog.CLEAR_JOINT_EFFORTS, gazebo_messages.ClearJointEffortsRequest(joint)
        )

    def joint_properties(self, joint: str) -> gazebo_messages.GetJointPropertiesReport:
        """Ask how a joint moves, and where it is."""
        request = gazebo_messages.GetJointPropertiesRequest(joint)
        return self._call(service_catalog.GET_JOINT_PROPERTIES, request)

    def set_joint_properties(self, joint: str, wanted: ODEJointProperties) -> None:
        """Change damping, friction and limits of a joint."""
        request = gazebo_messages.SetJointPropertiesRequest(joint, wanted)
        self._call(service_catalog.SET_JOINT_PROPERTIES, request)

    def link_properties(self, link: str) -> gazebo_messages.GetLinkPropertiesReport:
        """Ask what a link weighs."""
        request = gazebo_messages.GetLinkPropertiesRequest(link)
        return self._call(service_catalog.GET_LINK_PROPERTIES, request)

    def set_link_properties(self, request: gazebo_messages.SetLinkPropertiesRequest) -> None:
        """Change what a link weighs; every field counts."""
        self._call(service_catalog.SET_LINK_PROPERTIES, request)

    def _call(self, service: Service[Request, Response], request: Request) -> Response:
        return self.bus.call(service, request, world=self.world, timeout_s=self._timeout_s)


def _to_time(seconds: float) -> Time:
    return Time(*divmod(round(seconds * NANOSECONDS), NANOSECONDS))


def _to_duration(seconds: float) -> Duration:
    return Duration(*divmod(round(seconds * NANOSECONDS), NANOSECONDS))
