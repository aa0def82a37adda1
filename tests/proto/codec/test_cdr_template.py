"""A template yields the bytes of the codec."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zensim.proto.codec import cdr
from zensim.proto.codec.cdr_template import CdrTemplate
from zensim.proto.messages.standard_messages import Header, JointState, time_from_ns

NAMES = ("left", "right")
PATHS = ("position[0]", "position[1]", "velocity[0]", "velocity[1]")


def joint_states(time_ns: int, values: list[float]) -> JointState:
    header = Header(time_from_ns(time_ns), "base_link")
    return JointState(header, NAMES, tuple(values[:2]), tuple(values[2:]))


def a_template() -> CdrTemplate:
    return CdrTemplate(joint_states(0, [0.0] * 4), numbers=PATHS, stamps=("header.stamp",))


@given(
    moments=st.lists(
        st.tuples(
            st.integers(0, (1 << 31) * 1_000_000_000 - 1),
            st.lists(st.floats(width=64), min_size=4, max_size=4),
        ),
        min_size=1,
        max_size=3,
    )
)
def test_template_yields_the_bytes_of_the_codec_each_time(
    moments: list[tuple[int, list[float]]],
) -> None:
    template = a_template()

    for time_ns, values in moments:
        assert template.payload(time_ns, values) == cdr.encode(joint_states(time_ns, values))


def test_template_without_numbers_fills_in_the_stamp() -> None:
    template = CdrTemplate(joint_states(0, [1.0] * 4), numbers=(), stamps=("header.stamp",))

    assert template.payload(5, []) == cdr.encode(joint_states(5, [1.0] * 4))


def test_template_refuses_too_few_numbers() -> None:
    with pytest.raises(struct.error):
        a_template().payload(0, [0.0] * 3)
