"""Type hashes against published ones and an independent implementation."""

import struct
from typing import Annotated, Any, ClassVar

import msgspec
import pytest
from rosbags.typesys import Stores, get_typestore

from tests.proto.codec.test_cdr import EXPRESSIBLE, ros_type_of
from tests.proto.ros_hashes import hash_of_message, hash_of_service
from tests.proto.ros_oracle import knows
from zensim.proto.codec import cdr
from zensim.proto.messages import standard_messages
from zensim.proto.messages.spawn_messages import SpawnEntityOrder, SpawnEntityRequest
from zensim.proto.ros2.type_hash import find_service_type, hash_service, hash_type
from zensim.proto.sample_messages import make_sample_message
from zensim.proto.service_catalog import SERVICES, Service

PUBLISHED = {
    standard_messages.Odometry: "3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
    standard_messages.Twist: "9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a",
    standard_messages.String: "df668c74",
    standard_messages.TFMessage: "e369d0f0",
    standard_messages.TwistStamped: "5f0fcd4f",
    standard_messages.JointState: "a13ee3a3",
    standard_messages.Clock: "692f7a66",
    standard_messages.PoseStamped: "10f3786d",
    standard_messages.LaserScan: "64c19139",
    standard_messages.Imu: "7d9a00ff",
    standard_messages.Range: "b42b6256",
    standard_messages.PointCloud2: "9198cabf",
    standard_messages.PointField: "5c6a4750",
    standard_messages.NavSatFix: "62223ab3",
    standard_messages.NavSatStatus: "d1ed3bef",
    standard_messages.Image: "d31d41a9",
    standard_messages.CameraInfo: "b3dfd68f",
    standard_messages.RegionOfInterest: "ad16bcba",
    standard_messages.MagneticField: "e80f32f5",
    standard_messages.Vector3Stamped: "d4829622",
    standard_messages.FluidPressure: "22dfb2b1",
}
"""Hashes or their prefixes."""
PUBLISHED_SERVICES = {
    "delete_entity": "ff7e96a5b83dc8e2bb34b8b034480028b3a24d9f8376b2c0590bac3704be3e28",
    "get_available_worlds": "ce5589b5523f2732d1969a3c5a7e6b17a387091df8190c62f78d7fdd1109e3e3",
    "get_current_world": "79ed4e910e1b7a1c9f7950ff758bfba3535bf0dec669054e8af115a099724ddd",
    "get_entities": "cb90004c48cd50f37732fb008e22c34c261dd680a723bf0f85d8437ea4498bf7",
    "get_entities_states": "0a76170d0c1c90e1eaf805cfab78ea801d1f82df309a28c1f0fae4b570f19754",
    "get_entity_bounds": "17be8d36231178a5eed0de0344b55c19975581627a9aec30a4fee9926a35deed",
    "get_entity_info": "953b7ab6bfc35063f5c9a72463c6ce489baa10249a7fa510926d342a34b0d29e",
    "get_entity_state": "749c91f2a2353d98367b64f2995a0f5842ce92a08ec1ffb3e185540a91557fb5",
    "get_named_pose_bounds": "59fa8dd2c68ba6771160cc66a628ac99fa95e2748fa0a43c2cc62a2e5f3f6fdc",
    "get_named_poses": "c3d12ab920115bfd4733f6d20516adc3968fb438538540997c37e200e02b04e3",
    "get_simulation_state": "3362dcebee4b1afebbf9c4beee5c79c1455385aded62092a892d61fde8644f30",
    "get_simulator_features": "abb9439c8cf196722a469fb6c68b44b484f198c2a1356ac38849a29c2a20a794",
    "get_spawnables": "3e25fd827d8bcbd9db5e36ccb190efa22d6f6313897861268ab923bf091a992a",
    "load_world": "87d0ded1bfddb40a74d0bedb963fdd592fbedb14d0057d597850404b73c338af",
    "reset_simulation": "4ce285d7ff9b8ac70dcc95161f32bf54c05a6f4b13427990e41ab40c36c39646",
    "set_entity_info": "867fe2b6812f3e021859171f9b788560d66bb7079d640030baf6c0bb2dd2631e",
    "set_entity_state": "fba636c91d38832dbd4f6896ffce54ff98fd9929962b0533546b56ce00f988ac",
    "set_simulation_state": "a868b916dce49974f637ba252141258c4b07b0c06858b88af560e3eb6bfbcb30",
    "spawn_entities": "41703a359ee032bf4fc230f144f531705ba039a2e97edeae1f7997dd83b04857",
    "spawn_entity": "66860313e11009faddbfc8568e5d410d1a11607fe75eeb1308671dc0406fe3a7",
    "step_simulation": "913fe0653690ce6bf8f09f316e6a626747012e9fca31e26719910d417aa8565c",
    "unload_world": "ac7f9a73df1b5b15015d854c5ac552b7726506e22f886c6792804f0b7f88b30b",
}
"""Computed from the interface files of simulation_interfaces 2.1."""


Int64 = Annotated[int, msgspec.Meta(extra={"cdr": "q"})]


class AddTwoIntsRequest(msgspec.Struct, frozen=True):
    ros_type: ClassVar[str] = "example_interfaces/srv/AddTwoInts_Request"

    a: Int64 = 0
    b: Int64 = 0


class AddTwoIntsResponse(msgspec.Struct, frozen=True):
    ros_type: ClassVar[str] = "example_interfaces/srv/AddTwoInts_Response"

    sum: Int64 = 0


class TriggerRequest(msgspec.Struct, frozen=True):
    ros_type: ClassVar[str] = "std_srvs/srv/Trigger_Request"


class TriggerResponse(msgspec.Struct, frozen=True):
    ros_type: ClassVar[str] = "std_srvs/srv/Trigger_Response"

    success: bool = False
    message: str = ""


class NoWidth(msgspec.Struct, frozen=True):
    ros_type: ClassVar[str] = "ours/msg/NoWidth"

    number: int = 0


def known_services() -> list[object]:
    return [
        pytest.param(service, id=name)
        for name, service in SERVICES.items()
        if all(is_known(kind) for kind in (service.request, service.response))
    ]


def is_known(kind: type[msgspec.Struct]) -> bool:
    return cdr.is_expressible(kind) and knows(ros_type_of(kind)) and "/srv/" in ros_type_of(kind)


@pytest.mark.parametrize("kind", PUBLISHED, ids=lambda kind: kind.__name__)
def test_type_hash_is_the_published_one(kind: type[msgspec.Struct]) -> None:
    assert hash_type(kind).startswith(f"RIHS01_{PUBLISHED[kind]}")


@pytest.mark.parametrize("kind", EXPRESSIBLE)
def test_type_hash_is_what_another_implementation_finds(kind: type[msgspec.Struct]) -> None:
    assert hash_type(kind) == hash_of_message(ros_type_of(kind))


@pytest.mark.parametrize("name", PUBLISHED_SERVICES)
def test_service_hash_is_the_published_one(name: str) -> None:
    service = SERVICES[name]

    found = hash_service(service.request, service.response)

    assert found == f"RIHS01_{PUBLISHED_SERVICES[name]}"


@pytest.mark.parametrize("service", known_services())
def test_service_hash_is_what_another_implementation_finds(
    service: Service[msgspec.Struct, msgspec.Struct],
) -> None:
    found = hash_service(service.request, service.response)

    assert found == hash_of_service(find_service_type(service.request))


def test_service_hash_is_that_of_the_design_document() -> None:
    found = hash_service(AddTwoIntsRequest, AddTwoIntsResponse)

    assert found == "RIHS01_e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a"


def test_service_hash_counts_the_dummy_of_an_empty_half() -> None:
    found = hash_service(TriggerRequest, TriggerResponse)

    assert found == "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"


def test_type_hash_is_that_of_the_class_that_names_the_interface() -> None:
    assert hash_type(SpawnEntityOrder) == hash_type(SpawnEntityRequest)


def test_type_hash_refuses_a_number_without_a_width() -> None:
    with pytest.raises(TypeError, match="'number'"):
        hash_type(NoWidth)


def test_range_without_its_last_field_is_that_of_humble() -> None:
    humble = get_typestore(Stores.ROS2_HUMBLE)
    reading = make_sample_message(standard_messages.Range)
    payload = cdr.encode(reading)[: -struct.calcsize("f")]

    read: Any = humble.deserialize_cdr(payload, "sensor_msgs/msg/Range")

    assert humble.hash_rihs01("sensor_msgs/msg/Range").startswith("RIHS01_9430b191")
    assert (read.min_range, read.range) == (reading.min_range, reading.range)
    assert bytes(humble.serialize_cdr(read, "sensor_msgs/msg/Range")) == payload
