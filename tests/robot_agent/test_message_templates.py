"""Templates of odometry and tf against the codec."""

from hypothesis import given
from hypothesis import strategies as st

from zensim.proto.codec import cdr
from zensim.proto.codec.cdr_template import CdrTemplate
from zensim.proto.message_paths import HEADER_STAMP, ODOMETRY_PATHS, list_tf_paths, list_tf_stamps
from zensim.proto.messages.standard_messages import (
    Header,
    Quaternion,
    TFMessage,
    Time,
    Transform,
    TransformStamped,
    Vector3,
)
from zensim.robot_agent.odometry import BaseMotion, OdometryHeader

numbers = st.floats(width=64)
times_ns = st.integers(min_value=0, max_value=(1 << 31) * 1_000_000_000 - 1)
frames = st.text(max_size=9)


def stamp(time_ns: int) -> Time:
    return Time(*divmod(time_ns, 1_000_000_000))


def edge(names: tuple[str, str], time: Time, pose: list[float]) -> TransformStamped:
    transform = Transform(Vector3(*pose[:3]), Quaternion(*pose[3:]))
    return TransformStamped(Header(time, names[0]), names[1], transform)


@given(
    names=st.tuples(frames, frames),
    time_ns=times_ns,
    values=st.lists(numbers, min_size=10, max_size=10),
)
def test_odometry_template_yields_the_bytes_of_the_codec(
    names: tuple[str, str], time_ns: int, values: list[float]
) -> None:
    odometry = OdometryHeader(*names, *(tuple(float(n) for n in range(36)),) * 2)
    x, y, z, qx, qy, qz, qw, *twist = values
    written = cdr.encode(
        odometry.message(BaseMotion((x, y, z), (qx, qy, qz, qw), *twist), stamp(time_ns))
    )

    template = CdrTemplate(
        odometry.message(BaseMotion(), Time()), numbers=ODOMETRY_PATHS, stamps=HEADER_STAMP
    )

    assert template.payload(time_ns, values) == written


@given(
    names=st.lists(st.tuples(frames, frames), max_size=3),
    moments=st.lists(st.tuples(times_ns, numbers), min_size=1, max_size=3),
)
def test_tf_template_yields_the_bytes_of_the_codec_each_time(
    names: list[tuple[str, str]], moments: list[tuple[int, float]]
) -> None:
    def message(time_ns: int, value: float) -> TFMessage:
        return TFMessage(tuple(edge(one, stamp(time_ns), [value] * 7) for one in names))

    template = CdrTemplate(
        message(0, 0.0), numbers=list_tf_paths(len(names)), stamps=list_tf_stamps(len(names))
    )

    for time_ns, value in moments:
        filled = template.payload(time_ns, [value] * (7 * len(names)))
        assert filled == cdr.encode(message(time_ns, value))
