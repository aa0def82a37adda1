"""QoS profiles are written and read as rmw_zenoh does."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from zenoh_ros2_sdk.qos import QosDurability, QosProfile, QosReliability

from tests.proto.ros2.token_parser import read_qos
from zensim.proto.ros2.qos_profiles import (
    DEFAULT_QOS,
    INFINITE_NS,
    LATCHED,
    RELIABLE_10,
    RMW_DURABILITY,
    RMW_HISTORY,
    RMW_LIVELINESS,
    RMW_RELIABILITY,
    Qos,
    write_qos,
)

PROFILES = {
    "::,10:,:,:,,": RELIABLE_10,
    "2::,5:,:,:,,": Qos(reliability="best_effort", depth=5),
    ":1:,1:,:,:,,": LATCHED,
    "::,:,:,:,,": DEFAULT_QOS,
    "2:1:2,:,:,:,,": Qos(
        reliability="best_effort", durability="transient_local", history="keep_all"
    ),
    "::,1:1,500000000:,:2,0,3": Qos(
        depth=1, deadline_ns=1_500_000_000, liveliness="manual_by_node", lease_ns=3
    ),
}
SPANS = st.one_of(st.just(INFINITE_NS), st.integers(0, 9_000_000_000_000_000_000))
ANY_QOS = st.builds(
    Qos,
    reliability=st.sampled_from(sorted(RMW_RELIABILITY)),
    durability=st.sampled_from(sorted(RMW_DURABILITY)),
    history=st.sampled_from(sorted(RMW_HISTORY)),
    depth=st.integers(0, 1 << 63),
    deadline_ns=SPANS,
    lifespan_ns=SPANS,
    liveliness=st.sampled_from(sorted(RMW_LIVELINESS)),
    lease_ns=SPANS,
)


@pytest.mark.parametrize("text", PROFILES)
def test_qos_is_written_with_its_defaults_empty(text: str) -> None:
    assert write_qos(PROFILES[text]) == text
    assert read_qos(text) == PROFILES[text]


@given(ANY_QOS)
def test_qos_is_read_as_written(qos: Qos) -> None:
    assert read_qos(write_qos(qos)) == qos


def test_qos_is_read_by_another_implementation() -> None:
    theirs = QosProfile.decode(write_qos(Qos(reliability="best_effort", depth=5)))
    latched = QosProfile.decode(write_qos(LATCHED))

    assert (theirs.reliability, theirs.history_depth) == (QosReliability.BEST_EFFORT, 5)
    assert (latched.durability, latched.history_depth) == (QosDurability.TRANSIENT_LOCAL, 1)
