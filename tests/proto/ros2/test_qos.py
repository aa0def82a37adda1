import pytest
from hypothesis import given
from hypothesis import strategies as st
from zenoh_ros2_sdk.qos import QosDurability, QosProfile, QosReliability

from zensim.proto.ros2.qos import (
    DEFAULT,
    DURABILITY,
    HISTORY,
    INFINITE_NS,
    LATCHED,
    LIVELINESS,
    RELIABILITY,
    RELIABLE_10,
    Qos,
    read_qos,
    write_qos,
)

PROFILES = {
    "::,10:,:,:,,": RELIABLE_10,
    "2::,5:,:,:,,": Qos(reliability="best_effort", depth=5),
    ":1:,1:,:,:,,": LATCHED,
    "::,:,:,:,,": DEFAULT,
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
    reliability=st.sampled_from(sorted(RELIABILITY)),
    durability=st.sampled_from(sorted(DURABILITY)),
    history=st.sampled_from(sorted(HISTORY)),
    depth=st.integers(0, 1 << 63),
    deadline_ns=SPANS,
    lifespan_ns=SPANS,
    liveliness=st.sampled_from(sorted(LIVELINESS)),
    lease_ns=SPANS,
)


@pytest.mark.parametrize("text", PROFILES)
def test_qos_is_written_with_its_defaults_empty(text: str) -> None:
    assert write_qos(PROFILES[text]) == text
    assert read_qos(text) == PROFILES[text]


@given(ANY_QOS)
def test_qos_is_read_as_written(qos: Qos) -> None:
    assert read_qos(write_qos(qos)) == qos


def test_qos_is_understood_by_another_implementation() -> None:
    theirs = QosProfile.decode(write_qos(Qos(reliability="best_effort", depth=5)))
    latched = QosProfile.decode(write_qos(LATCHED))

    assert (theirs.reliability, theirs.history_depth) == (QosReliability.BEST_EFFORT, 5)
    assert (latched.durability, latched.history_depth) == (QosDurability.TRANSIENT_LOCAL, 1)


def test_qos_reads_defaults_that_are_spelled_out() -> None:
    assert read_qos("1:2:1,42:,:,:1,,") == DEFAULT


@pytest.mark.parametrize(
    "text",
    ["", "::", "::,10:,:,:,", "::10:,:,:,,", "3::,10:,:,:,,", "::,-1:,:,:,,", "::,10:,:,:,,,"],
)
def test_qos_is_nothing_when_parts_or_commas_are_missing(text: str) -> None:
    assert read_qos(text) is None
