"""Integer and float widths and fixed-size arrays, as annotations that codecs and schemas read."""

from typing import Annotated

from msgspec import Meta

UInt8 = Annotated[int, Meta(ge=0, le=0xFF, extra={"cdr": "B"})]
Int8 = Annotated[int, Meta(ge=-0x80, le=0x7F, extra={"cdr": "b"})]
UInt16 = Annotated[int, Meta(ge=0, le=0xFFFF, extra={"cdr": "H"})]
Int32 = Annotated[int, Meta(ge=-0x8000_0000, le=0x7FFF_FFFF, extra={"cdr": "i"})]
UInt32 = Annotated[int, Meta(ge=0, le=0xFFFF_FFFF, extra={"cdr": "I"})]
# Bounds beyond 63 bits cannot be stated to msgspec; the 64-bit codecs refuse what does not fit.
Int64 = Annotated[int, Meta(extra={"cdr": "q"})]
UInt64 = Annotated[int, Meta(ge=0, extra={"cdr": "Q"})]
Float32 = Annotated[float, Meta(extra={"cdr": "f"})]
Float64 = Annotated[float, Meta(extra={"cdr": "d"})]

Matrix6 = Annotated[
    tuple[float, ...], Meta(min_length=36, max_length=36, extra={"cdr": "d", "length": 36})
]
"""Row-major 6 x 6 covariance over (x, y, z, roll, pitch, yaw)."""

ZERO_MATRIX6: tuple[float, ...] = (0.0,) * 36
