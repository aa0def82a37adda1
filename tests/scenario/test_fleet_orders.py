"""Vehicles of a scenario carry out orders of VDA 5050."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.scenario.scenario_runs import run_alone
from tests.scenario.test_robot_behaviours import drive
from tests.zensim.vda5050.orders import Part, edge, line
from zensim.deploy.scenario_process import RunRequest
from zensim.scenario.scenario_nodes import ScenarioInvalid

BEHAVIOUR = "{name: tour, robots: 'r[0-1]', do: orders, file: tour.json}"


def of(robot: str, given: Part) -> Part:
    return given | {"serialNumber": robot}


def write(folder: Path, *orders: Part) -> None:
    (folder / "tour.json").write_text(json.dumps(orders))


def test_order_without_a_serial_number_is_for_each_robot(tmp_path: Path) -> None:
    given = line((0.2, 0.0), (2.0, 0.0))
    given.pop("serialNumber")
    (tmp_path / "tour.json").write_text(json.dumps(given))

    track = drive(tmp_path, BEHAVIOUR.replace("r[0-1]", "r0"), 6.0)

    assert track[-1, :2, 0] == pytest.approx([2.0, 5.0], abs=0.05)


def test_orders_follow_each_other_and_updates_extend(tmp_path: Path) -> None:
    first = line((0.0, 0.0), (1.0, 0.0), (2.0, 0.0), released=2)
    update = line((1.0, 0.0), (2.0, 0.0), update=1)
    for number, part in enumerate(update["nodes"]):
        part |= {"nodeId": f"n{2 * number + 2}", "sequenceId": 2 * number + 2}
    update["edges"] = [edge(3)]
    second = line((2.0, 0.0), (2.0, 2.0), name="o2")
    write(tmp_path, of("r0", first), of("r0", update), of("r0", second))

    track = drive(tmp_path, BEHAVIOUR, 16.0)

    at_corner = np.hypot(track[:, 0, 0] - 2.0, track[:, 0, 1])
    assert at_corner.min() < 0.03
    assert track[-1, 0, :2] == pytest.approx([2.0, 2.0], abs=0.05)


def test_order_that_a_vehicle_rejects_ends_the_run(tmp_path: Path) -> None:
    write(tmp_path, of("r1", line((0.0, 0.0), (1.0, 0.0))))

    with pytest.raises(ValueError, match="r1, order 'o1'"):
        drive(tmp_path, BEHAVIOUR, 1.0)


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("[{}]", "orderId"),
        ("{", "no orders"),
        (json.dumps(of("nobody", line((0.0, 0.0), (1.0, 0.0)))), "nobody"),
    ],
)
def test_broken_orders_are_a_mistake_of_the_file(text: str, what: str, tmp_path: Path) -> None:
    (tmp_path / "tour.json").write_text(text)

    with pytest.raises(ScenarioInvalid, match=what):
        drive(tmp_path, BEHAVIOUR, 1.0)


@pytest.mark.parametrize(("by", "is_passed"), [("9 s", True), ("2 s", False)])
def test_scenario_checks_when_a_vehicle_arrives(
    tmp_path: Path, by: str, *, is_passed: bool
) -> None:
    write(tmp_path, of("amr", line((0.0, 0.0), (1.0, 0.0), (1.0, 1.0))))
    file = tmp_path / "tour.scenario.yaml"
    file.write_text(f"""zensim: 1
robots: [{{name: amr, model: box_bot}}]
behaviours: [{{name: tour, robots: amr, do: orders, file: tour.json, speed: 0.8}}]
checks: [{{name: arrives, robots: amr, that: reached, point: [1, 1], tolerance: 0.1, by: {by}}}]
end: {{at: 10 s}}
""")

    report = run_alone(RunRequest(str(file)))

    assert report.is_passed is is_passed
