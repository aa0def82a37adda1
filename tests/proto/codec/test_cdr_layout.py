"""Struct types that are expressible in CDR, and errors of others."""

import struct
from operator import attrgetter
from typing import ClassVar, Literal

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.proto.strategies import messages_of
from tests.proto.widest import Nothing, Widest
from zensim.proto.codec import cdr
from zensim.proto.codec.cdr_layout import (
    CdrLayout,
    FixedLeaf,
    NumbersLeaf,
    StringLeaf,
    compile_structs,
    find_offsets,
    find_ros_class,
    group_runs,
)
from zensim.proto.messages.agent_messages import Claim, ClaimEntityRequest
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.spawn_messages import SpawnEntityReport, SpawnEntityResponse
from zensim.proto.messages.standard_messages import (
    Header,
    Image,
    JointState,
    LaserScan,
    OccupancyGrid,
    Odometry,
    Point,
    Pose,
    Quaternion,
    TFMessage,
    Time,
    TransformStamped,
    Twist,
    TwistWithCovariance,
)
from zensim.proto.messages.telemetry_messages import Stats


def numbers_of(message: msgspec.Struct) -> dict[str, tuple[str, object]]:
    """List a message's own numbers by path, with their codes; not those of items."""
    found: dict[str, tuple[str, object]] = {}
    for leaf in CdrLayout(type(message)).leaves:
        if not isinstance(leaf, FixedLeaf | NumbersLeaf) or not leaf.path:
            continue
        value = attrgetter(leaf.path)(message)
        if isinstance(leaf, FixedLeaf) and leaf.length is None:
            found[leaf.path] = (leaf.code, value)
        else:
            found |= {f"{leaf.path}[{i}]": (leaf.code, one) for i, one in enumerate(value)}
    return found


@given(message=messages_of(Widest))
def test_numbers_are_at_their_places_whatever_the_message(message: Widest) -> None:
    payload, places = cdr.encode(message), find_offsets(message)

    for path, (code, value) in numbers_of(message).items():
        (found,) = struct.unpack_from(f"<{code}", payload, places[path])
        assert found == value


@pytest.mark.parametrize("kind", [Odometry, JointState])
def test_places_name_all_numbers(kind: type[msgspec.Struct]) -> None:
    message = kind()
    arrays = {path for path in find_offsets(message) if isinstance(value_at(message, path), tuple)}

    assert set(find_offsets(message)) - arrays == set(numbers_of(message))


def value_at(message: msgspec.Struct, path: str) -> object:
    """Find the value at a path without index; None with one."""
    return None if "[" in path else attrgetter(path)(message)


@pytest.mark.parametrize("kind", [Image, OccupancyGrid, LaserScan])
@given(data=st.data())
def test_places_name_the_first_byte_of_a_sequence(
    kind: type[msgspec.Struct], data: st.DataObject
) -> None:
    message = data.draw(messages_of(kind))
    payload, places = cdr.encode(message), find_offsets(message)

    for path in ("data",) if kind is not LaserScan else ("ranges", "intensities"):
        value = attrgetter(path)(message)
        expected = value if isinstance(value, bytes) else struct.pack(f"<{len(value)}f", *value)
        assert payload[places[path] : places[path] + len(expected)] == expected


def test_numbers_of_items_are_found_behind_texts_of_any_length() -> None:
    transforms = tuple(
        TransformStamped(Header(Time(7, 8), "f" * length), "c" * length) for length in range(5)
    )
    message = TFMessage(transforms)
    payload, places = cdr.encode(message), find_offsets(message)

    for number in range(5):
        stamp = struct.unpack_from("<iI", payload, places[f"transforms[{number}].header.stamp.sec"])
        turn = places[f"transforms[{number}].transform.rotation.w"]
        assert stamp == (7, 8)
        assert struct.unpack_from("<d", payload, turn) == (1.0,)


class Widthless(msgspec.Struct, frozen=True):
    ros_type: ClassVar[str] = "zensim_test/msg/Widthless"

    count: int = 0


class Choice(msgspec.Struct, frozen=True):
    ros_type: ClassVar[str] = "zensim_test/msg/Choice"

    kind: Literal["a", "b"] = "a"


class Perhaps(msgspec.Struct, frozen=True):
    ros_type: ClassVar[str] = "zensim_test/msg/Perhaps"

    pose: Pose | None = None


class Nested(msgspec.Struct, frozen=True):
    ros_type: ClassVar[str] = "zensim_test/msg/Nested"

    rows: tuple[tuple[float, ...], ...] = ()


INEXPRESSIBLE = [Widthless, Choice, Perhaps, Nested, Model, Claim, ClaimEntityRequest, Stats]


@pytest.mark.parametrize("kind", INEXPRESSIBLE)
def test_layout_refuses_a_type_that_cdr_has_no_form_for(kind: type[msgspec.Struct]) -> None:
    with pytest.raises(TypeError, match=kind.__name__):
        CdrLayout(kind)

    assert not cdr.is_expressible(kind)


def test_layout_names_the_field_that_cdr_has_no_form_for() -> None:
    with pytest.raises(TypeError, match="on_release"):
        CdrLayout(ClaimEntityRequest)


def test_layout_refuses_a_type_without_a_ros_type() -> None:
    with pytest.raises(TypeError, match="Claim"):
        CdrLayout(Claim)


def test_layout_counts_the_least_bytes_of_a_message() -> None:
    assert CdrLayout(Twist).min_bytes == 48
    assert CdrLayout(Header).min_bytes == 12


def test_layout_gives_each_form_of_field_its_places() -> None:
    layout = CdrLayout(Widest)

    fixed = {leaf.path: leaf.slots for leaf in layout.leaves if isinstance(leaf, FixedLeaf)}

    assert fixed["flag"] == range(1, 2)
    assert fixed["shorts"] == range(2, 4)
    assert fixed["flags"] == range(7, 10)
    assert [leaf.path for leaf in layout.leaves if not isinstance(leaf, FixedLeaf)] == [
        "text",
        "blob",
        "many_flags",
        "many_shorts",
        "many_wide",
        "many_ratios",
        "many_texts",
        "many_points",
        "many_nothings",
    ]


def test_layout_builds_a_message_from_its_values() -> None:
    assert CdrLayout(Pose).build([1.0, 2.0, 3.0, 0.0, 0.0, 0.6, 0.8]) == Pose(
        Point(1.0, 2.0, 3.0), Quaternion(z=0.6, w=0.8)
    )
    assert CdrLayout(TwistWithCovariance).build([0.0] * 42) == TwistWithCovariance()
    assert CdrLayout(Nothing).build([]) == Nothing()


def test_ros_class_is_the_nearest_that_names_the_interface() -> None:
    assert find_ros_class(SpawnEntityReport) is SpawnEntityResponse
    assert find_ros_class(SpawnEntityResponse) is SpawnEntityResponse


def test_runs_join_fixed_leaves_up_to_the_next_sized_one() -> None:
    sec, nanosec, frame_id = CdrLayout(Header).leaves

    assert group_runs([sec, nanosec, frame_id, sec]) == [[sec, nanosec], frame_id, [sec]]
    assert isinstance(frame_id, StringLeaf)


def test_structs_pad_by_the_offset_of_their_run() -> None:
    run = [FixedLeaf("flag", 0, "?"), FixedLeaf("number", 1, "d")]

    sizes = [image.size for image in compile_structs(run, "<")]

    assert sizes == [16, 15, 14, 13, 12, 11, 10, 9]
