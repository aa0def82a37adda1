"""Noise that is keyed by seed, sensor and step."""

import math
from itertools import pairwise

import numpy as np
import pytest

from zensim.proto.messages.model_messages import Sensor
from zensim.proto.messages.sensing_messages import Environment
from zensim.proto.messages.sensor_messages import Noise
from zensim.proto.sensor_noise import (
    DYNAMIC_BIAS,
    DynamicBiases,
    SensorNoise,
    draw_fixed_biases,
    draw_normals,
    make_noise_key,
)

ENVIRONMENT = Environment(seed=7, step_ns=5_000_000, control_steps=1)
LIDAR = Sensor("lidar", "ray", "base_link", "base_link")
IMU = Sensor("imu", "imu", "base_link", "base_link")
GAUSSIAN = Noise(kind="gaussian", mean=0.5, stddev=0.2)


def make_keys(count: int, seed: int = 7) -> list[int]:
    return [make_noise_key(seed, f"r{number}", LIDAR) for number in range(count)]


def correlate(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.corrcoef(one.ravel(), other.ravel())[0, 1])


def test_keys_differ_by_seed_entity_link_and_name_of_the_sensor() -> None:
    other_link = Sensor("lidar", "ray", "mast", "mast")

    keys = {
        make_noise_key(7, "r1", LIDAR),
        make_noise_key(8, "r1", LIDAR),
        make_noise_key(7, "r2", LIDAR),
        make_noise_key(7, "r1", IMU),
        make_noise_key(7, "r1", other_link),
    }

    assert len(keys) == 5


def test_keys_do_not_mix_up_parts_of_names() -> None:
    one = make_noise_key(7, "r", Sensor("b", "ray", "1a", "1a"))

    assert one != make_noise_key(7, "r1", Sensor("b", "ray", "a", "a"))


def test_normals_are_those_of_earlier_releases() -> None:
    drawn = draw_normals(np.array([1, 2], dtype=np.uint64), counter=3, count=2)

    assert drawn == pytest.approx(np.array(EARLIER_NORMALS), abs=1e-12)


EARLIER_NORMALS = [
    [1.7659143906380332, -0.03619522954511343],
    [-0.013813834887421163, -2.386359507384697],
]


def test_normals_of_a_million_draws_have_mean_0_and_deviation_1() -> None:
    keys = np.array(make_keys(10), dtype=np.uint64)

    drawn = np.concatenate([draw_normals(keys, step, 1000) for step in range(100)])

    assert drawn.size == 1_000_000
    assert abs(drawn.mean()) < 0.01
    assert drawn.std() == pytest.approx(1.0, abs=0.01)
    assert abs(float((drawn**3).mean())) < 0.02
    assert float((drawn**4).mean()) == pytest.approx(3.0, abs=0.05)


def test_normals_of_steps_rays_robots_and_purposes_are_not_correlated() -> None:
    keys = np.array(make_keys(2), dtype=np.uint64)

    drawn = np.stack([draw_normals(keys, step, 1000) for step in range(1000)])
    walk = np.stack([draw_normals(keys, step, 1000, DYNAMIC_BIAS) for step in range(1000)])

    assert abs(correlate(drawn[1:], drawn[:-1])) < 0.01
    assert abs(correlate(drawn[:, :, 1:], drawn[:, :, :-1])) < 0.01
    assert abs(correlate(drawn[:, 0], drawn[:, 1])) < 0.01
    assert abs(correlate(drawn, walk)) < 0.01


@pytest.mark.parametrize("count", [1, 2, 7, 360])
def test_normals_have_the_same_bits_in_any_batch(count: int) -> None:
    keys = np.array(make_keys(33), dtype=np.uint64)

    together = draw_normals(keys, 12345, 361)
    alone = np.concatenate([draw_normals(keys[row : row + 1], 12345, count) for row in range(33)])
    backwards = draw_normals(keys[::-1], 12345, count)[::-1]

    assert together[:, :count].tobytes() == alone.tobytes()
    assert backwards.tobytes() == alone.tobytes()


def test_noise_has_the_mean_and_deviation_that_are_set() -> None:
    noise = SensorNoise([GAUSSIAN], make_keys(10), ENVIRONMENT)

    found = np.concatenate([noise.apply(np.full((10, 1000), 3.0), step) for step in range(100)])

    assert found.mean() == pytest.approx(3.5, rel=0.01)
    assert found.std() == pytest.approx(0.2, rel=0.01)


def test_noise_of_each_column_is_its_own() -> None:
    quiet, loud = Noise(kind="gaussian", stddev=0.1), Noise(kind="gaussian", stddev=2.0)
    noise = SensorNoise([quiet, loud, Noise()], make_keys(200), ENVIRONMENT)

    found = np.concatenate([noise.apply(np.zeros((200, 3)), step) for step in range(100)])

    assert found.std(axis=0) == pytest.approx([0.1, 2.0, 0.0], rel=0.03)


def test_noise_of_kind_none_changes_nothing() -> None:
    noise = SensorNoise([Noise(mean=1.0, stddev=1.0)], make_keys(2), ENVIRONMENT)
    values = np.array([[1.0], [2.0]])

    assert not noise.is_noisy
    assert noise.apply(values, 1) is values


def test_noise_does_not_depend_on_the_steps_before() -> None:
    walking = Noise(
        kind="gaussian", stddev=0.1, dynamic_bias_stddev=0.3, dynamic_bias_correlation_time_s=2.0
    )
    one = SensorNoise([walking], make_keys(3), ENVIRONMENT)
    other = SensorNoise([walking], make_keys(5)[:3], ENVIRONMENT)
    values = np.zeros((3, 4))

    found = {step: one.apply(values, step).tobytes() for step in (*range(0, 900, 3), 100_000)}

    for step in (899 // 3 * 3, 100_000, 3, 6, 0, 450):
        assert other.apply(values, step).tobytes() == found[step]


def test_quantized_noise_gives_multiples_of_the_precision() -> None:
    coarse = Noise(kind="gaussian_quantized", stddev=1.0, precision=0.25)
    noise = SensorNoise([coarse], make_keys(4), ENVIRONMENT)

    found = noise.apply(np.full((4, 100), 0.1), 9)

    assert (found % 0.25 == 0.0).all()
    assert len(np.unique(found)) > 5


def test_fixed_bias_is_drawn_once_per_sensor() -> None:
    biased = Noise(kind="gaussian", bias_mean=1.0, bias_stddev=0.5)
    noise = SensorNoise([biased], make_keys(10_000), ENVIRONMENT)
    values = np.zeros((10_000, 1))

    first, later = noise.apply(values, 0), noise.apply(values, 1000)

    assert first.tobytes() == later.tobytes()
    assert first.mean() == pytest.approx(1.0, abs=0.02)
    assert first.std() == pytest.approx(0.5, rel=0.03)


def test_fixed_bias_changes_its_sign_only_as_gazebo11_does() -> None:
    biased = [Noise(kind="gaussian", bias_mean=1.0)]
    keys = np.array(make_keys(10_000), dtype=np.uint64)

    fixed = draw_fixed_biases(biased, keys, "fixed")
    gazebo11 = draw_fixed_biases(biased, keys, "gazebo11")

    assert (fixed == 1.0).all()
    assert set(np.unique(gazebo11)) == {-1.0, 1.0}
    assert abs(gazebo11.mean()) < 0.05


def test_dynamic_bias_is_stationary_and_forgets_at_its_correlation_time() -> None:
    """Source: an Ornstein-Uhlenbeck process has variance stddev^2 * time / 2."""
    walking = Noise(kind="gaussian", dynamic_bias_stddev=0.4, dynamic_bias_correlation_time_s=0.5)
    keys = np.array(make_keys(500), dtype=np.uint64)
    biases = DynamicBiases([walking], keys, 0.005)

    walks = np.stack([biases.at(step)[:, 0] for step in range(1000)])

    assert walks.std() == pytest.approx(0.4 * math.sqrt(0.25), rel=0.03)
    assert walks[0].std() == pytest.approx(0.2, rel=0.1)
    assert correlate(walks[100:], walks[:-100]) == pytest.approx(math.exp(-1.0), abs=0.05)
    increments = walks[1:] - walks[:-1]
    expected = 0.2 * math.sqrt(2.0 * (1.0 - math.exp(-0.01)))
    assert increments.std() == pytest.approx(expected, rel=0.02)
    assert np.abs(increments.std(axis=1) / expected - 1.0).max() < 0.2


def test_dynamic_bias_is_alike_across_the_ends_of_its_blocks() -> None:
    walking = Noise(kind="gaussian", dynamic_bias_stddev=0.4, dynamic_bias_correlation_time_s=0.005)
    keys = np.array(make_keys(20_000), dtype=np.uint64)
    biases = DynamicBiases([walking], keys, 0.005)

    around = [biases.at(step)[:, 0] for step in (30, 31, 32, 33)]

    for one, other in pairwise(around):
        assert correlate(one, other) == pytest.approx(math.exp(-1.0), abs=0.03)


def test_noise_of_ranges_stays_within_the_limits_and_keeps_what_is_not_measured() -> None:
    noise = SensorNoise([Noise(kind="gaussian", stddev=1.0)], make_keys(50), ENVIRONMENT)
    ranges = np.tile([0.2, 5.0, 9.9, math.inf, -math.inf, math.nan], (50, 40))

    found = noise.apply_to_ranges(ranges, 3, range_min_m=0.1, range_max_m=10.0)

    measured = found[np.isfinite(ranges)]
    assert measured.min() >= 0.1
    assert measured.max() <= 10.0
    assert (found[:, 3::6] == math.inf).all()
    assert (found[:, 4::6] == -math.inf).all()
    assert np.isnan(found[:, 5::6]).all()
    assert found[:, 1::6].std() == pytest.approx(1.0, rel=0.05)
