"""Images that `make image` has built: what is in them, and that they run as they are deployed."""

import os
import re
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.integration.image_runs import MountedImage, measure_mb, mounted
from tests.integration.processes import children, eventually, free_endpoint
from tests.integration.scraping import find_free_port, probe
from zensim.proto.exit_codes import ExitCode

pytestmark = pytest.mark.images

TARGETS = os.environ.get("IMAGES", "agent server full").split()
USER = 10001
WITHIN_S = 120.0
MOST_MB = {"agent": 240, "server": 480, "full": 510}
PACKAGES = {
    "agent": (set(), {"pybullet", "mujoco", "scipy", "viser"}),
    "server": (
        {"mujoco", "pybullet", "trimesh", "embreex", "lxml", "yourdfpy"},
        {"pybullet_data", "viser"},
    ),
    "full": ({"mujoco", "pybullet", "viser", "yourdfpy"}, {"pybullet_data"}),
}
"""What an image has, and what it lacks."""
INSTALLERS = ("apt", "apt-get", "dpkg", "gcc", "perl", "pip", "pip3")


@pytest.fixture(scope="module", params=TARGETS)
def image(request: pytest.FixtureRequest) -> Iterator[MountedImage]:
    with mounted(request.param) as found:
        yield found


@pytest.fixture
def state(tmp_path: Path) -> Path:
    folder = tmp_path / "state"
    folder.mkdir()
    os.chown(folder, USER, USER)
    return folder


def test_image_has_its_packages_and_no_pip(image: MountedImage) -> None:
    packages = next(image.root.glob("opt/zensim/lib/python3*/site-packages"))
    names = {path.name.partition(".")[0] for path in packages.iterdir()}  # also of one file
    present, missing = PACKAGES[image.target]

    assert {"zensim", "zenoh", "numpy", "prometheus_client"} | present <= names
    assert not names & ({"pip", "setuptools"} | missing)
    assert not [one for one in INSTALLERS if (image.root / "usr" / "bin" / one).exists()]
    assert not list(image.root.glob("usr/lib/*/perl*"))
    assert measure_mb(image.root) < MOST_MB[image.target]


def test_image_lists_the_packages_of_debian_that_it_has(image: MountedImage) -> None:
    """For scanners of vulnerabilities; each has its licence."""
    status = (image.root / "var" / "lib" / "dpkg" / "status").read_text()
    names = re.findall(r"^Package: (\S+)$", status, re.MULTILINE)
    documented = [name for name in names if list_copyrights(image.root, name)]

    assert {"libc6", "libssl3", "python3.11-minimal"} <= set(names)
    assert "perl-base" not in names
    assert documented == names


def list_copyrights(root: Path, package: str) -> list[Path]:
    """List the licence of a package, also of one whose folder is a link to that of another."""
    folder = root / "usr" / "share" / "doc" / package
    if folder.is_symlink():
        folder = folder.parent / folder.readlink().name
    return list(folder.glob("copyright"))


def test_modules_of_the_image_are_compiled(image: MountedImage) -> None:
    """A root that is read-only keeps no bytecode, so each start would compile them all."""
    packages = next(image.root.glob("opt/zensim/lib/python3*/site-packages"))
    modules = [
        packages / "zensim" / "proto" / "bus.py",
        image.root / "usr/lib/python3.11/json/decoder.py",
    ]

    assert [
        len(list((one.parent / "__pycache__").glob(f"{one.stem}.*.pyc"))) for one in modules
    ] == [1, 1]


def test_programs_run_as_a_user_on_a_read_only_root(image: MountedImage, state: Path) -> None:
    shown = image.run(state, "zensim", "--version")
    fails, works = "touch /opt/zensim/x /etc/x /x 2>&1", "touch /tmp/x /var/lib/zensim/x"
    script = f"id -u; {fails}; {works} && echo written"
    done = image.run(state, "sh", "-c", script)

    assert (shown.returncode, shown.stderr) == (ExitCode.OK, "")
    lines = done.stdout.splitlines()
    assert (lines[0], lines[-1]) == (str(USER), "written")
    assert sum("Read-only file system" in line for line in lines) == 3


def test_program_of_the_image_becomes_ready_and_ends(image: MountedImage, state: Path) -> None:
    port, endpoint = find_free_port(), free_endpoint()
    is_agent = image.target == "agent"
    words = (
        ("router", "--listen", endpoint)
        if is_agent
        else ("serve", "--listen", endpoint, "--journal", "/var/lib/zensim/j", "--metrics", port)
    )
    with image.running(state, "zensim", *words) as process:
        if is_agent:
            waiting = ("agent", "--pool", "0", "--connect", endpoint, "--wait", "60")
            with image.running(state, "zensim", *waiting, "--metrics", port):
                eventually(lambda: probe(port, "/livez") == 200, WITHIN_S, "life")
        else:
            eventually(lambda: probe(port, "/readyz") == 200, WITHIN_S, "readiness")
            fleet = ("fleet", "box_bot", "--robots", "3", "--connect", endpoint)
            done = image.run(state, "zensim", *fleet)
            assert done.returncode == ExitCode.OK, done.stderr
        (program, *_) = children(process.pid)
        os.kill(program, signal.SIGTERM)

        assert process.wait(WITHIN_S) == ExitCode.OK
    assert is_agent or (state / "j" / "journal.db").is_file()
