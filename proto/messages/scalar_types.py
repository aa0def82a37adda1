"""Integer widths and fixed-size arrays, as annotations for codecs and schemas."""

from typing import Annotated

from msgspec import Meta

UInt8 = Annotated[int, Meta(ge=0, le=0xFF, extra={"cdr": "B"})]
Int8 = Annotated[int, Meta(ge=-0x80, le=0x7F, extra={"cdr": "b"})]
UInt16 = Annotated[int, Meta(ge=0, le=0xFFFF, extra={"cdr": "H"})]
Int32 = Annotated[int, Meta(ge=-0x8000_0000, le=0x7FFF_FFFF, extra={"cdr": "i"})]
UInt32 = Annotated[int, Meta(ge=0, le=0xFFFF_FFFF, extra={"cdr": "I"})]
# msgspec has no bounds beyond 63 bits; the codecs check the range of UInt64.
UInt64 = Annotated[int, Meta(ge=0, extra={"cdr": "Q"})]

Float32 = Annotated[float, Meta(extra={"cdr": "f"})]
"""A float with the precision and the bytes of float32."""
Int8s = Annotated[bytes, Meta(extra={"cdr": "b"})]
"""A sequence of int8, as their bytes."""

Matrix3 = Annotated[
    tuple[float, ...], Meta(min_length=9, max_length=9, extra={"cdr": "d", "length": 9})
]
"""Row-major 3 x 3 matrix."""
Matrix3x4 = Annotated[
    tuple[float, ...], Meta(min_length=12, max_length=12, extra={"cdr": "d", "length": 12})
]
"""Row-major 3 x 4 matrix."""
Matrix6 = Annotated[
    tuple[float, ...], Meta(min_length=36, max_length=36, extra={"cdr": "d", "length": 36})
]
"""Row-major 6 x 6 covariance over (x, y, z, roll, pitch, yaw)."""

ZERO_MATRIX3: tuple[float, ...] = (0.0,) * 9
ZERO_MATRIX3X4: tuple[float, ...] = (0.0,) * 12
ZERO_MATRIX6: tuple[float, ...] = (0.0,) * 36
