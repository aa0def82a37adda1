"""GazeboClient: a typed method for each service with a name of Gazebo."""

from zensim.proto import service_catalog
from zensim.proto.bus.bus_session import Bus
from zensim.proto.messages import gazebo_messages
from zensim.proto.messages.gazebo_messages import GazeboEntityState, ODEJointProperties
from zensim.proto.messages.standard_messages import NANOSECONDS, Duration, Point, Time, Wrench
from zensim.proto.service_catalog import Request, Response, Service

CALL_TIMEOUT_S = 10.0
FOREVER_S = -1.0
ORIGIN = Point()


class GazeboClient:
    """Client of the Gazebo services of one world.

    Methods raise ServiceError if the server refuses, TimeoutError or NoServer without a reply.
    Links and joints have Gazebo's names: `entity::link`. Times are simulation times.
    """

    def __init__(self, bus: Bus, world: str = "default", timeout_s: float = CALL_TIMEOUT_S) -> None:
        self.bus = bus
        self.world = world
        self._timeout_s = timeout_s

    def entity_state(self, name: str, reference_frame: str = "") -> GazeboEntityState:
        """Get pose and twist of an entity or link, in the world or another frame."""
        request = gazebo_messages.GazeboGetEntityStateRequest(name, reference_frame)
        return self._call(service_catalog.GAZEBO_GET_ENTITY_STATE, request).state

    def set_entity_state(self, state: GazeboEntityState) -> None:
        """Set pose and twist of an entity, in the frame given by the state."""
        request = gazebo_messages.GazeboSetEntityStateRequest(state)
        self._call(service_catalog.GAZEBO_SET_ENTITY_STATE, request)

    def pause_physics(self) -> None:
        """Pause the simulation."""
        self._call(service_catalog.PAUSE_PHYSICS, gazebo_messages.PausePhysicsRequest())

    def unpause_physics(self) -> None:
        """Resume the simulation."""
        self._call(service_catalog.UNPAUSE_PHYSICS, gazebo_messages.UnpausePhysicsRequest())

    def reset_world(self) -> None:
        """Reset all entities to their initial poses; time continues."""
        self._call(service_catalog.RESET_WORLD, gazebo_messages.ResetWorldRequest())

    def reset_simulation(self) -> None:
        """Reset time, and all entities to their initial poses; spawned entities stay."""
        request = gazebo_messages.GazeboResetSimulationRequest()
        self._call(service_catalog.GAZEBO_RESET_SIMULATION, request)

    def model_list(self) -> gazebo_messages.GetModelListReport:
        """List the names of all entities."""
        return self._call(service_catalog.GET_MODEL_LIST, gazebo_messages.GetModelListRequest())

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
        """Apply a wrench to a link for a duration, and return the status with start and end."""
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
        """Remove all wrenches of a link."""
        self._call(
            service_catalog.CLEAR_LINK_WRENCHES, gazebo_messages.ClearLinkWrenchesRequest(link)
        )

    def apply_joint_effort(
        self, joint: str, effort: float, *, start_s: float = 0.0, duration_s: float = FOREVER_S
    ) -> str:
        """Apply an effort [N m or N] to a joint for a duration, and return the status."""
        request = gazebo_messages.ApplyJointEffortRequest(
            joint, effort, _to_time(start_s), _to_duration(duration_s)
        )
        return self._call(service_catalog.APPLY_JOINT_EFFORT, request).status_message

    def clear_joint_efforts(self, joint: str) -> None:
        """Remove all efforts of a joint."""
        self._call(
            service_catalog.CLEAR_JOINT_EFFORTS, gazebo_messages.ClearJointEffortsRequest(joint)
        )

    def joint_properties(self, joint: str) -> gazebo_messages.GetJointPropertiesReport:
        """Get type, damping, positions and rates of a joint."""
        request = gazebo_messages.GetJointPropertiesRequest(joint)
        return self._call(service_catalog.GET_JOINT_PROPERTIES, request)

    def set_joint_properties(self, joint: str, properties: ODEJointProperties) -> None:
        """Set damping, friction and limits of a joint."""
        request = gazebo_messages.SetJointPropertiesRequest(joint, properties)
        self._call(service_catalog.SET_JOINT_PROPERTIES, request)

    def link_properties(self, link: str) -> gazebo_messages.GetLinkPropertiesReport:
        """Get mass and inertia of a link."""
        request = gazebo_messages.GetLinkPropertiesRequest(link)
        return self._call(service_catalog.GET_LINK_PROPERTIES, request)

    def set_link_properties(self, request: gazebo_messages.SetLinkPropertiesRequest) -> None:
        """Set mass and inertia of a link; all fields are used."""
        self._call(service_catalog.SET_LINK_PROPERTIES, request)

    def _call(self, service: Service[Request, Response], request: Request) -> Response:
        return self.bus.call(service, request, world=self.world, timeout_s=self._timeout_s)


def _to_time(seconds: float) -> Time:
    return Time(*divmod(round(seconds * NANOSECONDS), NANOSECONDS))


def _to_duration(seconds: float) -> Duration:
    return Duration(*divmod(round(seconds * NANOSECONDS), NANOSECONDS))
