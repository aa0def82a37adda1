"""The wheel, installed outside the checkout together with PyPI's proto-plus."""

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

from tests.contract.repository import ROOT
from tests.integration.processes import free_endpoint
from tests.zensim.api.test_scripts import SCRIPTS

DATA = {
    "zensim/py.typed",
    "zensim/proto/schemas/messages.json",
    "zensim/sim_server/models/box_bot.urdf",
    "zensim/sim_server/worlds/empty.sdf",
}
MOST_MEGABYTES_OF_SERVER = 740
BARE_NAMES = ("deploy", "proto", "robot_agent", "sim_server", "spawner")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the wheel from a copy of the tracked files: the build writes into its sources."""
    folder = tmp_path_factory.mktemp("wheel")
    listing = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard"],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    )
    for name in listing.stdout.splitlines():
        source, copy = ROOT / name, folder / "source" / name
        if source.is_file() or source.is_symlink():
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source, copy, follow_symlinks=False)
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--no-input", "wheel", "-q"]
    options = ["--no-deps", "--no-build-isolation", "--wheel-dir", str(folder), "."]
    subprocess.run([*pip, *options], cwd=folder / "source", check=True)
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def python(wheel: Path) -> Path:
    """Install the wheel; its dependencies are those of the running environment."""
    home = wheel.parent / "environment"
    venv.create(home, with_pip=False)
    (packages,) = home.glob("lib/python3.*/site-packages")
    # A path in a .pth file is not searched for further .pth files: the checkout is excluded.
    (packages / "dependencies.pth").write_text(sysconfig.get_path("purelib"), encoding="utf-8")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(packages)
    return home / "bin" / "python"


def run(python: Path, *words: str, **more: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [python, *words],
        cwd=python.parent,
        env={name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | more,
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
    )


def test_wheel_holds_one_top_level_name_and_its_data(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())

    top = {name.split("/")[0] for name in names}

    assert {name for name in top if not name.endswith(".dist-info")} == {"zensim"}
    assert names >= DATA


def test_metadata_of_the_wheel_has_no_links_into_the_repository(wheel: Path) -> None:
    archive = zipfile.ZipFile(wheel)
    (metadata,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))

    text = archive.read(metadata).decode()

    links = re.findall(r"\]\(([^)]*)\)", text)
    assert links
    assert all(link.startswith("https://") for link in links)


def test_wheel_holds_the_licences(wheel: Path) -> None:
    names = {Path(name).name for name in zipfile.ZipFile(wheel).namelist()}

    assert names >= {"LICENSE", "NOTICE"}


def test_notice_names_the_licence_of_each_package() -> None:
    command = [sys.executable, str(ROOT / ".ci" / "notices.py"), "--check"]

    done = subprocess.run(command, capture_output=True, text=True, check=False)

    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("change", ["", "removed-package: MIT\n"], ids=["lacks", "has too many"])
def test_notice_with_other_packages_is_refused(change: str, tmp_path: Path) -> None:
    """What is no longer needed must not stay for ever."""
    written = (ROOT / "NOTICE").read_text()
    other = written + change if change else written.replace("numpy: ", "numbers: ")
    (tmp_path / "NOTICE").write_text(other)
    script, pins = tmp_path / "ci" / "notices.py", tmp_path / "requirements" / "all.txt"
    for path, source in ((script, ".ci/notices.py"), (pins, "requirements/all.txt")):
        path.parent.mkdir()
        shutil.copy(ROOT / source, path)

    done = subprocess.run(
        [sys.executable, str(script), "--check"], capture_output=True, text=True, check=False
    )

    assert done.returncode == 1
    assert ("removed-package" if change else "numpy") in done.stderr


def test_server_is_small_on_disk() -> None:
    command = [sys.executable, str(ROOT / ".ci" / "sizes.py"), "server"]

    done = subprocess.run(command, capture_output=True, text=True, check=True)

    assert 100 < int(done.stdout.rsplit(",", 1)[1].strip(" |\n")) <= MOST_MEGABYTES_OF_SERVER


def test_wheel_and_proto_plus_are_both_complete(python: Path) -> None:
    code = (
        "import proto, zensim.proto.bus.bus_session\n"
        "class Point(proto.Message):\n"
        "    x = proto.Field(proto.DOUBLE, number=1)\n"
        "print(Point(x=2.0).x, zensim.proto.bus.bus_session.Bus.__name__, zensim.__file__)"
    )

    done = run(python, "-c", code)

    assert done.stderr == ""
    number, name, path = done.stdout.split()
    assert (number, name) == ("2.0", "Bus")
    assert Path(path).is_relative_to(python.parent.parent)


def test_programs_of_the_wheel_import_only_from_zensim(python: Path) -> None:
    code = (
        "import pkgutil, importlib, sys, zensim\n"
        "for module in pkgutil.walk_packages(zensim.__path__, 'zensim.'):\n"
        "    if not module.name.endswith(('__main__', '_worker', '_process')):\n"
        "        importlib.import_module(module.name)\n"
        f"print(sorted(set({BARE_NAMES!r}) & set(sys.modules)))"
    )

    done = run(python, "-c", code)

    assert done.stdout.strip() == "[]", done.stderr


def test_world_of_the_wheel_runs_robots(python: Path) -> None:
    up = ("up", "--robots", "2", "--duration", "1", "--no-viewer", "--listen", free_endpoint())

    done = run(python, "-m", "zensim", *up)

    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("title", ["Hello robot", "Snapshots"])
def test_program_of_the_documents_runs_on_the_wheel(python: Path, title: str) -> None:
    done = run(python, "-c", SCRIPTS[title])

    assert done.returncode == 0, done.stderr


@pytest.mark.long_form
def test_tests_pass_on_the_wheel(python: Path, wheel: Path) -> None:
    outside = wheel.parent / "outside"
    shutil.copytree(ROOT / "tests", outside / "tests")
    shutil.copy(ROOT / "pyproject.toml", outside)
    some = ("tests/proto/ros2", "tests/contract/test_golden.py", "tests/robot_agent")
    pytest_words = (
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "-c",
        str(outside / "pyproject.toml"),
    )

    done = run(python, *pytest_words, *(str(outside / name) for name in some))

    assert done.returncode == 0, done.stdout[-2000:]
    assert " passed" in done.stdout
