"""Runs of a sweep: known by their content, and validated before the first one."""

from pathlib import Path

import pytest

from tests.deploy.sweep.sweep_samples import SHORT, write_scenario
from zensim.deploy.sweep.sweep_plan import SweepPlan, SweepRun, make_plan
from zensim.scenario.scenario_nodes import ScenarioInvalid
from zensim.scenario.scenario_reader import read_scenario


def ids_of(plan: SweepPlan) -> set[str]:
    return {run.id for run in plan.runs}


def test_plan_has_a_run_for_each_combination_seed_and_repeat(tmp_path: Path) -> None:
    file = write_scenario(tmp_path, "{behaviours.go.v: [0.2, 0.3], seeds: 3, repeats: 2}")

    plan = make_plan(file)

    assert len(plan.runs) == len(ids_of(plan)) == 12
    assert len({run.seed for run in plan.runs}) == 6
    assert plan.paths == ("behaviours.go.v",)


def test_settings_of_a_run_make_its_scenario_of_the_file(tmp_path: Path) -> None:
    file = write_scenario(
        tmp_path, "{robots.r.yaw: [10 deg, {uniform: [0, 1]}], world.load: [walls], seeds: 2}"
    )

    for run in make_plan(file, ["end.at=0.25"]).runs:
        scenario = read_scenario(file, run.settings)

        assert scenario.sha256 == run.sha256
        assert scenario.seed == run.seed
        assert scenario.format.end.at == 0.25


def test_each_run_is_reported_when_it_was_validated(tmp_path: Path) -> None:
    reported: list[SweepRun] = []

    plan = make_plan(write_scenario(tmp_path, "{seeds: 3}"), on_run=reported.append)

    assert tuple(reported) == plan.runs


def test_run_without_seeds_has_the_seed_of_the_file(tmp_path: Path) -> None:
    plan = make_plan(write_scenario(tmp_path), ["time.seed=5"])

    assert [run.seed for run in plan.runs] == [5]


def test_more_values_seeds_and_another_order_keep_the_runs(tmp_path: Path) -> None:
    few = make_plan(write_scenario(tmp_path, "{behaviours.go.v: [0.2, 0.3], seeds: 2}"))
    many = make_plan(write_scenario(tmp_path, "{seeds: 3, behaviours.go.v: [0.4, 0.3, 0.2]}"))
    reordered = "\n".join([*SHORT.splitlines()[:2], *reversed(SHORT.splitlines()[2:]), ""])
    other = make_plan(
        write_scenario(tmp_path, "{behaviours.go.v: [0.2, 0.3], seeds: 2}", reordered)
    )

    assert ids_of(few) < ids_of(many)
    assert ids_of(other) == ids_of(few)


@pytest.mark.parametrize("setting", ["end.at=0.6", "time.seed=1", "engine.use=pybullet"])
def test_other_content_is_another_run(setting: str, tmp_path: Path) -> None:
    file = write_scenario(tmp_path, "{seeds: 1}")

    assert not ids_of(make_plan(file)) & ids_of(make_plan(file, [setting]))


@pytest.mark.parametrize("setting", ["viewer.port=9000", "description=x", "network.wait=3"])
def test_settings_that_change_no_run_keep_it(setting: str, tmp_path: Path) -> None:
    file = write_scenario(tmp_path, "{seeds: 1}")

    assert ids_of(make_plan(file)) == ids_of(make_plan(file, [setting]))


def test_changed_file_of_commands_is_another_run(tmp_path: Path) -> None:
    text = SHORT.replace("do: drive, v: 0.3", "do: replay, file: orders.csv")
    runs = []
    for folder, speed in (("a", 0.2), ("b", 0.3), ("c", 0.2)):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "orders.csv").write_text(f"time,v,w\n0,{speed},0\n")
        runs.append(ids_of(make_plan(write_scenario(tmp_path / folder, text=text))))

    assert runs[0] == runs[2] != runs[1]


def test_equal_runs_are_planned_once(tmp_path: Path) -> None:
    plan = make_plan(write_scenario(tmp_path, "{behaviours.go.v: [0.3, 300 mm/s]}"))

    assert len(plan.runs) == 1


def test_mistake_of_one_combination_is_found_with_its_values(tmp_path: Path) -> None:
    file = write_scenario(tmp_path, "{behaviours.go.robots: [r, nobody]}")

    with pytest.raises(ScenarioInvalid) as caught:
        make_plan(file)

    (issue,) = caught.value.issues
    assert issue.path == "behaviours[0].robots"
    assert "behaviours.go.robots=nobody" in issue.message
