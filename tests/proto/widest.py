"""A message with every form that a field may have in CDR, and its ROS definition."""

from typing import Annotated, ClassVar

import msgspec

from tests.proto.ros_oracle import define
from zensim.proto.messages.scalar_types import Int8, Int32, UInt8, UInt16, UInt32, UInt64
from zensim.proto.messages.standard_messages import Point

Int16 = Annotated[int, msgspec.Meta(ge=-0x8000, le=0x7FFF, extra={"cdr": "h"})]
Float32 = Annotated[float, msgspec.Meta(extra={"cdr": "f"})]
Float64 = Annotated[float, msgspec.Meta(extra={"cdr": "d"})]
Flags3 = Annotated[tuple[bool, ...], msgspec.Meta(min_length=3, max_length=3, extra={"length": 3})]
Shorts2 = Annotated[
    tuple[UInt16, ...], msgspec.Meta(min_length=2, max_length=2, extra={"cdr": "H", "length": 2})
]


class Nothing(msgspec.Struct, frozen=True):
    ros_type: ClassVar[str] = "zensim_test/msg/Nothing"


class Widest(msgspec.Struct, frozen=True):
    ros_type: ClassVar[str] = "zensim_test/msg/Widest"

    octet: UInt8 = 0
    flag: bool = False
    shorts: Shorts2 = (0, 0)
    tiny: Int8 = 0
    wide: UInt64 = 0
    signed_wide: Annotated[int, msgspec.Meta(ge=-(2**63), le=2**63 - 1, extra={"cdr": "q"})] = 0
    flags: Flags3 = (False, False, False)
    short: Int16 = 0
    ratio: Float32 = 0.0
    text: str = ""
    last_of_text: UInt8 = 0
    nothing: Nothing = Nothing()
    blob: bytes = b""
    many_flags: tuple[bool, ...] = ()
    many_shorts: tuple[UInt16, ...] = ()
    many_wide: tuple[UInt64, ...] = ()
    many_ratios: tuple[Float32, ...] = ()
    many_texts: tuple[str, ...] = ()
    many_points: tuple[Point, ...] = ()
    many_nothings: tuple[Nothing, ...] = ()
    count: UInt32 = 0
    offset: Int32 = 0
    number: Float64 = 0.0


define("zensim_test/msg/Nothing", "uint8 structure_needs_at_least_one_member")
define(
    "zensim_test/msg/Widest",
    "uint8 octet; bool flag; uint16[2] shorts; int8 tiny; uint64 wide; int64 signed_wide;"
    " bool[3] flags; int16 short; float32 ratio; string text; uint8 last_of_text; Nothing nothing;"
    " uint8[] blob; bool[] many_flags; uint16[] many_shorts; uint64[] many_wide;"
    " float32[] many_ratios; string[] many_texts; geometry_msgs/Point[] many_points;"
    " Nothing[] many_nothings; uint32 count; int32 offset; float64 number",
)
