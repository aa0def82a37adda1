"""The plug-in of pytest, in runs of pytest of their own."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

from zensim.proto.sensor_libraries import find_library_fault
from zensim.sim_server.scene.camera_selection import find_opengl_fault

PASSING = """
import pytest
from zensim.testing import expect

@pytest.mark.zensim(world="walls", seed=3, record="on-failure")
def test_reaches_its_goal(zensim_world):
    robot = zensim_world.spawn("box_bot")
    robot.follow([(0.5, 0.0)], speed=0.3)
    expect(robot).to_reach((0.5, 0.0), within=5.0)
    expect(robot).to_stop()
    assert zensim_world.seed == 3
    assert len(zensim_world.entities) > 1
"""
FAILING = """
from zensim.testing import expect

def test_is_too_far(zensim_world):
    robot = zensim_world.spawn("box_bot", name="r1")
    expect(robot).to_reach((9.0, 0.0), within=0.5)
"""
COLLIDING = """
from zensim.testing import expect

def test_touches_nothing(zensim_world):
    free = zensim_world.spawn("box_bot", name="free", y=2.0)
    robot = zensim_world.spawn("box_bot", name="r1")
    zensim_world.spawn("box_bot", name="r2", x=0.8)
    for one in (free, robot):
        one.drive(0.3, 0.0)
    zensim_world.run_for(3.0)
    expect(free).to_have_no_collision()
    expect(robot).to_have_no_collision()
"""
SCENARIO = """
zensim: 1
robots:
  - {name: robot, model: box_bot}
checks:
  - {name: there, robots: robot, that: reached, point: [POINT, 0], tolerance: 0.2, by: 1 s}
end: {at: 1 s}
"""
UNKNOWN = """
import pytest

@pytest.mark.zensim(wrld="walls")
def test_nothing(zensim_world):
    pass
"""
MARKED = """
import pytest

pytestmark = pytest.mark.zensim(seed=1, step_hz=100)
ENGINES = [
    pytest.param(one, marks=pytest.mark.zensim(engine=one)) for one in ("mujoco", "pybullet")
]

@pytest.mark.zensim(world="walls", seed=2)
class TestWalls:
    @pytest.mark.zensim(seed=4, engine="pybullet")
    @pytest.mark.parametrize("engine", ENGINES)
    def test_options_of_all_marks_count(self, zensim_world, engine):
        info = zensim_world.info
        assert (info.engine, zensim_world.seed, info.step_ns) == (engine, 4, 10_000_000)
        assert zensim_world.entities
"""
POSITIONAL = """
import pytest

@pytest.mark.zensim("walls")
def test_nothing(zensim_world):
    pass
"""
SERVED = """
import pytest

@pytest.mark.zensim(world="walls", engine="pybullet")
def test_nothing(zensim_sim):
    pass
"""


KILLED = """
import os
import signal
from pathlib import Path

def find_servers():
    for path in Path("/proc").glob("[0-9]*"):
        try:
            parent = int(path.joinpath("stat").read_text().rpartition(")")[2].split()[1])
            words = path.joinpath("cmdline").read_bytes().split(b"\\0")
        except (OSError, ValueError):
            continue
        if parent == os.getpid() and b"serve" in words:
            yield int(path.name)

def test_kills_its_server(zensim_sim):
    (server,) = find_servers()
    os.kill(server, signal.SIGKILL)
    zensim_sim.step(1)

def test_has_another(zensim_sim):
    assert zensim_sim.spawn("box_bot")

def test_has_it_again(zensim_sim):
    assert not zensim_sim.robots
"""


def run_pytest(folder: Path, text: str) -> subprocess.CompletedProcess[str]:
    (folder / "test_case.py").write_text(text)
    command = [sys.executable, "-m", "pytest", "-p", "zensim.testing", "-p", "no:cacheprovider"]
    return subprocess.run(
        [*command, "-q", "--rootdir", str(folder), "--junitxml=out.xml", "test_case.py"],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )


def test_a_passed_test_leaves_no_files(tmp_path: Path) -> None:
    done = run_pytest(tmp_path, PASSING)

    assert done.returncode == 0, done.stdout
    assert not (tmp_path / "test-results").exists()


def test_a_server_that_ends_in_a_test_fails_only_that_test(tmp_path: Path) -> None:
    done = run_pytest(tmp_path, KILLED)

    assert "1 failed, 2 passed" in done.stdout, done.stdout


def test_a_failed_test_leaves_report_and_events_and_names_them(tmp_path: Path) -> None:
    done = run_pytest(tmp_path, FAILING)

    folder = tmp_path / "test-results" / "test_case.py-test_is_too_far"
    report = json.loads((folder / "report.json").read_text())
    events = [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]
    assert done.returncode == 1, done.stdout
    assert report["entities"][0]["name"] == "r1"
    assert report["time"] == pytest.approx(0.5, abs=0.02)
    assert "distance" in report["message"]
    assert "spawned" in {one["kind"] for one in events}
    states = [json.loads(line) for line in (folder / "states.jsonl").read_text().splitlines()]
    assert states[-1]["poses"].keys() == {"r1"}
    assert states[-1]["time"] == pytest.approx(0.5, abs=0.05)
    assert "report.json" in (tmp_path / "out.xml").read_text()
    if not find_opengl_fault() or not find_library_fault("embree"):
        picture = Image.open(folder / "picture.png").convert("RGB")
        assert picture.size == (960, 600)
        assert len(picture.crop((380, 200, 580, 400)).getcolors(40_000) or ()) > 20


def test_a_collision_since_the_spawn_fails_and_a_drive_on_the_floor_does_not(
    tmp_path: Path,
) -> None:
    done = run_pytest(tmp_path, COLLIDING)

    assert done.returncode == 1, done.stdout
    assert "'r1' to have no collision" in done.stdout
    assert "touched 'r2'" in done.stdout


def test_scenario_files_are_tests(tmp_path: Path) -> None:
    (tmp_path / "good.scenario.yaml").write_text(SCENARIO.replace("POINT", "0"))
    (tmp_path / "bad.scenario.yaml").write_text(SCENARIO.replace("POINT", "9"))
    (tmp_path / "wrong.scenario.yaml").write_text(SCENARIO.replace("that: reached", "that: flies"))
    command = [sys.executable, "-m", "pytest", "-p", "zensim.testing", "-p", "no:cacheprovider"]
    done = subprocess.run(
        [*command, "-rA", "--rootdir", str(tmp_path), str(tmp_path)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )

    assert done.returncode == 1, done.stdout
    assert "1 passed" in done.stdout
    assert "2 failed" in done.stdout
    assert "PASSED good.scenario.yaml::good" in done.stdout
    assert "wrong.scenario.yaml:" in done.stdout


@pytest.mark.parametrize(
    ("text", "named"),
    [(UNKNOWN, "'wrld'"), (POSITIONAL, "'walls'"), (SERVED, "'engine'")],
    ids=["unknown", "without a keyword", "of a world in process, for a server"],
)
def test_an_option_that_the_marker_cannot_honour_is_an_error(
    tmp_path: Path, text: str, named: str
) -> None:
    done = run_pytest(tmp_path, text)

    assert done.returncode == 1
    assert named in done.stdout


def test_marks_of_module_class_function_and_parameter_add_up(tmp_path: Path) -> None:
    done = run_pytest(tmp_path, MARKED)

    assert "2 passed" in done.stdout, done.stdout


def test_the_plugin_imports_pytest_only() -> None:
    program = (
        "import sys, pytest\nbefore = set(sys.modules)\nimport zensim.testing\n"
        "print(*sorted(one for one in set(sys.modules) - before))\n"
    )

    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=600
    )

    own = ("zensim", "pytest")
    standard = sys.stdlib_module_names
    loaded = {name.partition(".")[0] for name in done.stdout.split()}
    assert {one for one in loaded if one not in own and one not in standard} == set()
