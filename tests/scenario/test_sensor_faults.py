"""Faults of sensors in a run: what is published from their control step to their end."""

from functools import partial

import numpy as np
import pytest

import zensim
from zensim.api.topic import find_stamp_ns
from zensim.proto.messages.standard_messages import LaserScan

SPECIAL = {"sensor_off": "", "sensor_bias": ", bias: 0.25", "sensor_sector": ", low: -1, high: 1"}
FAULTS = "".join(
    f"  - {{name: f{row}, at: 1, for: 1, robots: r{row}, do: {kind}, sensor: lidar{keys}}}\n"
    for row, (kind, keys) in enumerate(SPECIAL.items())
)
TEXT = (
    "zensim: 1\nworld: {load: walls}\nrobots:\n"
    "  - {name: r, model: box_bot_lidar, count: 3, layout: {spacing: 2 m}}\n"
    f"faults:\n{FAULTS}"
    "checks:\n  - {name: drops, that: rate, topic: r0/scan, below: 0.5, window: 0.5, after: f0, "
    "within: 1}\n"
    "  - {name: steady, that: rate, topic: r1/scan, above: 8}\n"
    "  - {name: returns, that: rate, topic: r0/scan, above: 8, window: 0.5, "
    "from: 2.7}\nend: {at: 3}\n"
)


def note(listed: list[tuple[float, LaserScan]], scan: LaserScan) -> None:
    listed.append((find_stamp_ns(scan) * 1e-9, scan))


@pytest.fixture(scope="module")
def scans(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[tuple[float, LaserScan]]]:
    """Scans of each robot with their times; the report's verdicts are in key ""."""
    file = tmp_path_factory.mktemp("run") / "a.scenario.yaml"
    file.write_text(TEXT)
    found: dict[str, list[tuple[float, LaserScan]]] = {f"r{row}": [] for row in range(3)}
    with zensim.load(file) as run:
        for name, listed in found.items():
            run.sim.topic(f"{name}/scan", LaserScan).on(partial(note, listed), queue=64)
        report = run.run()
    assert [one.verdict for one in report.checks] == ["passed"] * 3
    return found


def times(scans: list[tuple[float, LaserScan]]) -> list[float]:
    return [round(time, 1) for time, _ in scans]


def test_sensor_that_is_off_has_a_gap(scans: dict[str, list[tuple[float, LaserScan]]]) -> None:
    # The measurement of the step at which the fault starts has been published before.
    gone = {round(1.1 + number / 10, 1) for number in range(10)}
    found, steady = times(scans["r0"]), times(scans["r1"])

    assert gone - set(steady) == set()
    assert set(steady) - set(found) == gone


def test_bias_is_in_the_scans_of_the_fault(scans: dict[str, list[tuple[float, LaserScan]]]) -> None:
    before, during, after = (
        np.array(next(scan.ranges for at, scan in scans["r1"] if at >= time - 1e-3))
        for time in (0.5, 1.1, 2.1)
    )

    hit = np.isfinite(before)
    assert np.median(during[hit] - before[hit]) == pytest.approx(0.25, abs=0.03)
    assert np.median(after[hit] - before[hit]) == pytest.approx(0.0, abs=0.03)


def test_blind_sector_sees_nothing(scans: dict[str, list[tuple[float, LaserScan]]]) -> None:
    for time, is_blind in ((0.5, False), (1.5, True), (2.5, False)):
        scan = next(scan for at, scan in scans["r2"] if at >= time)
        angles = scan.angle_min + np.arange(len(scan.ranges)) * scan.angle_increment
        ahead = np.array(scan.ranges)[np.abs(angles) < 0.99]
        assert np.isinf(ahead).all() == is_blind
