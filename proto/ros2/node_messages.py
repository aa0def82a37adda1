"""Messages that every ROS 2 node uses: parameters, type descriptions and log lines."""

from enum import IntEnum
from typing import Annotated, ClassVar, Final

import msgspec
from msgspec import Meta

from zensim.proto.messages.scalar_types import UInt8, UInt32, UInt64
from zensim.proto.messages.standard_messages import Time

Int64 = Annotated[int, Meta(ge=-(2**63), le=2**63 - 1, extra={"cdr": "q"})]
ByteSequence = Annotated[bytes, Meta(extra={"cdr": "B", "rosidl": "byte"})]
"""A sequence of the type byte of ROS, which has a type id of its own."""
MAX_TYPE_NAME: Final = 255
TypeName = Annotated[str, Meta(extra={"bound": MAX_TYPE_NAME})]
"""`string<=255`."""


class ParameterType(IntEnum):
    """Types of parameters. Source: rcl_interfaces/msg/ParameterType."""

    NOT_SET = 0
    BOOL = 1
    INTEGER = 2
    DOUBLE = 3
    STRING = 4
    BYTE_ARRAY = 5
    BOOL_ARRAY = 6
    INTEGER_ARRAY = 7
    DOUBLE_ARRAY = 8
    STRING_ARRAY = 9


class ParameterValue(msgspec.Struct, frozen=True):
    """Value of a parameter; `type` says which field. Source: rcl_interfaces/msg/ParameterValue."""

    ros_type: ClassVar[str] = "rcl_interfaces/msg/ParameterValue"

    type: UInt8 = 0
    bool_value: bool = False
    integer_value: Int64 = 0
    double_value: float = 0.0
    string_value: str = ""
    byte_array_value: ByteSequence = b""
    bool_array_value: tuple[bool, ...] = ()
    integer_array_value: tuple[Int64, ...] = ()
    double_array_value: tuple[float, ...] = ()
    string_array_value: tuple[str, ...] = ()


class NamedParameter(msgspec.Struct, frozen=True):
    """A parameter. Source: rcl_interfaces/msg/Parameter."""

    ros_type: ClassVar[str] = "rcl_interfaces/msg/Parameter"

    name: str = ""
    value: ParameterValue = ParameterValue()


class FloatingPointRange(msgspec.Struct, frozen=True):
    """Range of a double. Source: rcl_interfaces/msg/FloatingPointRange."""

    ros_type: ClassVar[str] = "rcl_interfaces/msg/FloatingPointRange"

    from_value: float = 0.0
    to_value: float = 0.0
    step: float = 0.0


class IntegerRange(msgspec.Struct, frozen=True):
    """Range of an integer. Source: rcl_interfaces/msg/IntegerRange."""

    ros_type: ClassVar[str] = "rcl_interfaces/msg/IntegerRange"

    from_value: Int64 = 0
    to_value: Int64 = 0
    step: UInt64 = 0


class ParameterDescriptor(msgspec.Struct, frozen=True):
    """Description of a parameter. Source: rcl_interfaces/msg/ParameterDescriptor."""

    ros_type: ClassVar[str] = "rcl_interfaces/msg/ParameterDescriptor"

    name: str = ""
    type: UInt8 = 0
    description: str = ""
    additional_constraints: str = ""
    read_only: bool = False
    dynamic_typing: bool = False
    floating_point_range: Annotated[
        tuple[FloatingPointRange, ...], Meta(max_length=1, extra={"bound": 1})
    ] = ()
    integer_range: Annotated[tuple[IntegerRange, ...], Meta(max_length=1, extra={"bound": 1})] = ()


class SetParameterResult(msgspec.Struct, frozen=True):
    """Whether a parameter was set. Source: rcl_interfaces/msg/SetParametersResult."""

    ros_type: ClassVar[str] = "rcl_interfaces/msg/SetParametersResult"

    successful: bool = False
    reason: str = ""


class ListParametersResult(msgspec.Struct, frozen=True):
    """Names of parameters. Source: rcl_interfaces/msg/ListParametersResult."""

    ros_type: ClassVar[str] = "rcl_interfaces/msg/ListParametersResult"

    names: tuple[str, ...] = ()
    prefixes: tuple[str, ...] = ()


class GetParametersRequest(msgspec.Struct, frozen=True):
    """Get values. Source: rcl_interfaces/srv/GetParameters."""

    ros_type: ClassVar[str] = "rcl_interfaces/srv/GetParameters_Request"

    names: tuple[str, ...] = ()


class GetParametersResponse(msgspec.Struct, frozen=True):
    """Values in the order of the names; not set for unknown names."""

    ros_type: ClassVar[str] = "rcl_interfaces/srv/GetParameters_Response"

    values: tuple[ParameterValue, ...] = ()


class GetParameterTypesRequest(msgspec.Struct, frozen=True):
    """Get types. Source: rcl_interfaces/srv/GetParameterTypes."""

    ros_type: ClassVar[str] = "rcl_interfaces/srv/GetParameterTypes_Request"

    names: tuple[str, ...] = ()


class GetParameterTypesResponse(msgspec.Struct, frozen=True):
    """Types in the order of the names."""

    ros_type: ClassVar[str] = "rcl_interfaces/srv/GetParameterTypes_Response"

    types: tuple[UInt8, ...] = ()


class SetParametersRequest(msgspec.Struct, frozen=True):
    """Set parameters one by one. Source: rcl_interfaces/srv/SetParameters."""

    ros_type: ClassVar[str] = "rcl_interfaces/srv/SetParameters_Request"

    parameters: tuple[NamedParameter, ...] = ()


class SetParametersResponse(msgspec.Struct, frozen=True):
    """Result of each parameter."""

    ros_type: ClassVar[str] = "rcl_interfaces/srv/SetParameters_Response"

    results: tuple[SetParameterResult, ...] = ()


class SetParametersAtomicallyRequest(msgspec.Struct, frozen=True):
    """Set all parameters or none. Source: rcl_interfaces/srv/SetParametersAtomically."""

    ros_type: ClassVar[str] = "rcl_interfaces/srv/SetParametersAtomically_Request"

    parameters: tuple[NamedParameter, ...] = ()


class SetParametersAtomicallyResponse(msgspec.Struct, frozen=True):
    """Result of all parameters together."""

    ros_type: ClassVar[str] = "rcl_interfaces/srv/SetParametersAtomically_Response"

    result: SetParameterResult = SetParameterResult()


class ListParametersRequest(msgspec.Struct, frozen=True):
    """List names. Source: rcl_interfaces/srv/ListParameters."""

    ros_type: ClassVar[str] = "rcl_interfaces/srv/ListParameters_Request"

    prefixes: tuple[str, ...] = ()
    """Empty = all."""
    depth: UInt64 = 0
    """Most parts of a name after its prefix; 0 = any."""


class ListParametersResponse(msgspec.Struct, frozen=True):
    """Names of parameters."""

    ros_type: ClassVar[str] = "rcl_interfaces/srv/ListParameters_Response"

    result: ListParametersResult = ListParametersResult()


class DescribeParametersRequest(msgspec.Struct, frozen=True):
    """Describe parameters. Source: rcl_interfaces/srv/DescribeParameters."""

    ros_type: ClassVar[str] = "rcl_interfaces/srv/DescribeParameters_Request"

    names: tuple[str, ...] = ()


class DescribeParametersResponse(msgspec.Struct, frozen=True):
    """Descriptions in the order of the names."""

    ros_type: ClassVar[str] = "rcl_interfaces/srv/DescribeParameters_Response"

    descriptors: tuple[ParameterDescriptor, ...] = ()


class DescribedFieldType(msgspec.Struct, frozen=True):
    """Type of a field. Source: type_description_interfaces/msg/FieldType."""

    ros_type: ClassVar[str] = "type_description_interfaces/msg/FieldType"

    type_id: UInt8 = 0
    capacity: UInt64 = 0
    string_capacity: UInt64 = 0
    nested_type_name: TypeName = ""


class DescribedField(msgspec.Struct, frozen=True):
    """A field of a type. Source: type_description_interfaces/msg/Field."""

    ros_type: ClassVar[str] = "type_description_interfaces/msg/Field"

    name: str = ""
    type: DescribedFieldType = DescribedFieldType()
    default_value: str = ""


class IndividualTypeDescription(msgspec.Struct, frozen=True):
    """A type by itself. Source: type_description_interfaces/msg/IndividualTypeDescription."""

    ros_type: ClassVar[str] = "type_description_interfaces/msg/IndividualTypeDescription"

    type_name: TypeName = ""
    fields: tuple[DescribedField, ...] = ()


class WholeTypeDescription(msgspec.Struct, frozen=True):
    """A type and those it refers to. Source: type_description_interfaces/msg/TypeDescription."""

    ros_type: ClassVar[str] = "type_description_interfaces/msg/TypeDescription"

    type_description: IndividualTypeDescription = IndividualTypeDescription()
    referenced_type_descriptions: tuple[IndividualTypeDescription, ...] = ()


class TypeSource(msgspec.Struct, frozen=True):
    """Text of an interface file. Source: type_description_interfaces/msg/TypeSource."""

    ros_type: ClassVar[str] = "type_description_interfaces/msg/TypeSource"

    type_name: str = ""
    encoding: str = ""
    raw_file_contents: str = ""


class KeyValue(msgspec.Struct, frozen=True):
    """A further fact. Source: type_description_interfaces/msg/KeyValue."""

    ros_type: ClassVar[str] = "type_description_interfaces/msg/KeyValue"

    key: str = ""
    value: str = ""


class GetTypeDescriptionRequest(msgspec.Struct, frozen=True):
    """Describe a type. Source: type_description_interfaces/srv/GetTypeDescription."""

    ros_type: ClassVar[str] = "type_description_interfaces/srv/GetTypeDescription_Request"

    type_name: str = ""
    type_hash: str = ""
    include_type_sources: bool = True


class GetTypeDescriptionResponse(msgspec.Struct, frozen=True):
    """The description, or why there is none."""

    ros_type: ClassVar[str] = "type_description_interfaces/srv/GetTypeDescription_Response"

    successful: bool = False
    failure_reason: str = ""
    type_description: WholeTypeDescription = WholeTypeDescription()
    type_sources: tuple[TypeSource, ...] = ()
    extra_information: tuple[KeyValue, ...] = ()


class LogLevel(IntEnum):
    """Levels of log lines. Source: rcl_interfaces/msg/Log."""

    WARN = 30
    ERROR = 40
    FATAL = 50


class RosoutLog(msgspec.Struct, frozen=True):
    """A line of a node's log. Source: rcl_interfaces/msg/Log."""

    ros_type: ClassVar[str] = "rcl_interfaces/msg/Log"

    stamp: Time = Time()
    """Wall time, whatever `use_sim_time` is, as rcl writes it."""
    level: UInt8 = 0
    name: str = ""
    """Name of the logger: that of the node, with dots."""
    msg: str = ""
    file: str = ""
    function: str = ""
    line: UInt32 = 0


PARAMETER_SERVICES: Final[dict[str, tuple[type[msgspec.Struct], type[msgspec.Struct]]]] = {
    "describe_parameters": (DescribeParametersRequest, DescribeParametersResponse),
    "get_parameter_types": (GetParameterTypesRequest, GetParameterTypesResponse),
    "get_parameters": (GetParametersRequest, GetParametersResponse),
    "list_parameters": (ListParametersRequest, ListParametersResponse),
    "set_parameters": (SetParametersRequest, SetParametersResponse),
    "set_parameters_atomically": (SetParametersAtomicallyRequest, SetParametersAtomicallyResponse),
}
"""Requests and responses by name, which is below the node's."""
TYPE_SERVICE: Final = "get_type_description"
"""Service of distributions with type hashes."""
TYPE_SERVICES: Final[dict[str, tuple[type[msgspec.Struct], type[msgspec.Struct]]]] = {
    TYPE_SERVICE: (GetTypeDescriptionRequest, GetTypeDescriptionResponse)
}
"""Requests and responses by name of the services that nodes have since iron."""
