"""Which struct types CDR can express, and what is said of the others."""

from typing import ClassVar, Literal

import msgspec
import pytest

from tests.proto.widest import Nothing, Widest
from zensim.proto import cdr
from zensim.proto.cdr_layout import Fixed, Layout, Text, images, ros_class, runs
from zensim.proto.claims import Claim, ClaimEntityRequest
from zensim.proto.geometry import Point, Pose, Quaternion, Twist, TwistWithCovariance
from zensim.proto.header import Header
from zensim.proto.model import Model
from zensim.proto.services import SpawnEntityReport, SpawnEntityResponse
from zensim.proto.telemetry import Stats


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
    with pytest.raises(TypeError, match=f"^{kind.__name__} is not expressible in CDR, use "):
        Layout(kind)

    assert not cdr.is_expressible(kind)


def test_layout_names_the_field_that_cdr_has_no_form_for() -> None:
    with pytest.raises(TypeError, match=r"field 'on_release' is a LiteralType without a CDR width"):
        Layout(ClaimEntityRequest)


def test_layout_says_when_a_type_has_no_ros_name() -> None:
    with pytest.raises(TypeError, match="Claim has no ros_type"):
        Layout(Claim)


def test_layout_counts_the_least_bytes_of_a_message() -> None:
    assert Layout(Twist).least_bytes == 48
    assert Layout(Header).least_bytes == 12


def test_layout_gives_each_form_of_field_its_places() -> None:
    layout = Layout(Widest)

    fixed = {leaf.path: leaf.slots for leaf in layout.leaves if isinstance(leaf, Fixed)}

    assert fixed["flag"] == range(1, 2)
    assert fixed["shorts"] == range(2, 4)
    assert fixed["flags"] == range(7, 10)
    assert [leaf.path for leaf in layout.leaves if not isinstance(leaf, Fixed)] == [
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
    assert Layout(Pose).build([1.0, 2.0, 3.0, 0.0, 0.0, 0.6, 0.8]) == Pose(
        Point(1.0, 2.0, 3.0), Quaternion(z=0.6, w=0.8)
    )
    assert Layout(TwistWithCovariance).build([0.0] * 42) == TwistWithCovariance()
    assert Layout(Nothing).build([]) == Nothing()


def test_ros_class_is_the_nearest_that_names_the_interface() -> None:
    assert ros_class(SpawnEntityReport) is SpawnEntityResponse
    assert ros_class(SpawnEntityResponse) is SpawnEntityResponse


def test_runs_join_fixed_leaves_up_to_the_next_sized_one() -> None:
    sec, nanosec, frame_id = Layout(Header).leaves

    assert runs([sec, nanosec, frame_id, sec]) == [[sec, nanosec], frame_id, [sec]]
    assert isinstance(frame_id, Text)


def test_images_pad_by_the_place_that_a_run_begins_at() -> None:
    run = [Fixed("flag", 0, "?"), Fixed("number", 1, "d")]

    sizes = [image.size for image in images(run, "<")]

    assert sizes == [16, 15, 14, 13, 12, 11, 10, 9]
