"""The short page of benchmarks."""

from pathlib import Path

from benchmarks.bench_overview import KINEMATIC, MUJOCO, Fleet
from benchmarks.bench_overview import table as format_fleets
from benchmarks.bench_peers import Row
from benchmarks.bench_peers import table as format_peers
from benchmarks.measured_page import format_page
from benchmarks.overview_page import PLOTS, draw_plots, find_table, make_page

FLEETS = [
    Fleet(
        robots=robots,
        physics=physics,
        factor=1.0,
        driving=1.0,
        cores={"server": 0.25, "agents": 0.15},
        memory_mb={"server": 120.0, "agents": 140.0},
        spawned_s=0.5,
    )
    for physics in (MUJOCO, KINEMATIC)
    for robots in (10, 100)
]
LIMITS = """| figure | asked | seen |
|---|---|---|
| way [m] | max <= 2 | 3, **missed** |
| time [s] | max <= 2 | 1, met |
| mass [kg] |  | 5 |
"""
SECTIONS = {
    "overview": f"## Fleets\n\n`python -m benchmarks overview`\n\n{format_fleets(FLEETS)}",
    "peers": "## Peers\n\n`python -m benchmarks peers`\n\n"
    + format_peers([Row("other", robots=10, step_hz=10.0, factor=2.0, step_us=50.0)]),
    "start": f"## Start\n\n`python -m benchmarks start`\n\n{LIMITS}",
}
FACTS = (("cores", "2"), ("CPU", "Trial 9000"))
RESULTS = format_page("# Results\n", FACTS, SECTIONS, tuple(SECTIONS))


def test_page_has_machine_fleets_peers_and_what_is_missed() -> None:
    page = make_page(RESULTS)

    assert "2 cores, Trial 9000" in page
    assert "| 100 | kinematic | 20 | 1.00 | 100% | 0.25 | 0.15 | 200 | 120 | 140 | 0.5 |" in page
    assert "| other | 10 | 10 | 2 | 50 | 500 | 20 |" in page
    assert "2 figures have a [limit](limits.md)" in page
    assert "| way [m] | max <= 2 | 3 |" in page
    assert "| time [s] |" not in page


def test_page_says_what_was_not_measured() -> None:
    without = {name: text for name, text in SECTIONS.items() if name != "peers"}

    page = make_page(format_page("# Results\n", FACTS, without, tuple(without)))

    assert "Not measured yet." in page


def test_plots_have_a_line_for_each_kind_of_physics(tmp_path: Path) -> None:
    draw_plots(find_table(SECTIONS, "overview"), tmp_path)

    for name in PLOTS:
        drawing = (tmp_path / f"{name}.svg").read_text()
        assert all(fleet.physics.label in drawing for fleet in FLEETS)


def test_equal_figures_give_equal_plots(tmp_path: Path) -> None:
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
        draw_plots(find_table(SECTIONS, "overview"), tmp_path / folder)

    for name in PLOTS:
        one, two = (tmp_path / folder / f"{name}.svg" for folder in ("one", "two"))
        assert one.read_bytes() == two.read_bytes()
