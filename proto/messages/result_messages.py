"""Result codes of simulation_interfaces, the Result message, and the error of a refused request."""

from enum import IntEnum
from typing import ClassVar

import msgspec

from zensim.proto.messages.scalar_types import UInt8


class ResultCode(IntEnum):
    """Codes of every service. Source: simulation_interfaces/msg/Result."""

    FEATURE_UNSUPPORTED = 0
    OK = 1
    NOT_FOUND = 2
    INCORRECT_STATE = 3
    OPERATION_FAILED = 4


class SpawnCode(IntEnum):
    """Failures of a spawn. Source: simulation_interfaces/srv/SpawnEntity."""

    NAME_NOT_UNIQUE = 101
    NAME_INVALID = 102
    UNSUPPORTED_FORMAT = 103
    NO_RESOURCE = 104
    NAMESPACE_INVALID = 105
    RESOURCE_PARSE_ERROR = 106
    MISSING_ASSETS = 107
    UNSUPPORTED_ASSETS = 108
    INVALID_POSE = 109


class SpawnEntitiesCode(IntEnum):
    """Failures of several spawns. Source: simulation_interfaces/srv/SpawnEntities."""

    ENTITIES_SPAWN_FAILED = 150


class SetEntityStateCode(IntEnum):
    """Failures of setting a state. Source: simulation_interfaces/srv/SetEntityState."""

    INVALID_POSE = 101


class SetSimulationStateCode(IntEnum):
    """Failures of a transition. Source: simulation_interfaces/srv/SetSimulationState."""

    ALREADY_IN_TARGET_STATE = 101
    STATE_TRANSITION_ERROR = 102
    INCORRECT_TRANSITION = 103


class LoadWorldCode(IntEnum):
    """Failures of loading a world. Source: simulation_interfaces/srv/LoadWorld."""

    UNSUPPORTED_FORMAT = 101
    NO_RESOURCE = 102
    RESOURCE_PARSE_ERROR = 103
    MISSING_ASSETS = 104
    UNSUPPORTED_ASSETS = 105
    UNSUPPORTED_ELEMENTS = 106


class UnloadWorldCode(IntEnum):
    """Failures of unloading a world. Source: simulation_interfaces/srv/UnloadWorld."""

    NO_WORLD_LOADED = 101


class GetCurrentWorldCode(IntEnum):
    """Failures of reading the current world. Source: simulation_interfaces/srv/GetCurrentWorld."""

    NO_WORLD_LOADED = 101


class GetAvailableWorldsCode(IntEnum):
    """Failures of listing worlds. Source: simulation_interfaces/srv/GetAvailableWorlds."""

    DEFAULT_SOURCES_FAILED = 101


class ClaimCode(IntEnum):
    """Failures of a claim. Source: zensim."""

    ALREADY_CLAIMED = 101
    AGENT_INVALID = 102
    NOT_DRIVABLE = 103


class Result(msgspec.Struct, frozen=True):
    """Result of a request. Source: simulation_interfaces/msg/Result."""

    ros_type: ClassVar[str] = "simulation_interfaces/msg/Result"

    result: UInt8 = ResultCode.OK
    error_message: str = ""


class ServiceError(Exception):
    """The server refused a request; code, message and response are those of the reply."""

    def __init__(
        self,
        service: str,
        code: int,
        code_name: str,
        message: str,
        response: msgspec.Struct | None = None,
    ) -> None:
        super().__init__(f"{code_name} ({code}): {message}")
        self.response = response
        self.service = service
        self.code = code
        self.code_name = code_name
        self.message = message
