"""Commands without the extras, without a physics engine and a page."""

import subprocess
import sys

import pytest

from tests.contract.repository import ROOT
from zensim.proto.exit_codes import ExitCode

WITHOUT_EXTRAS = """
import sys, pkgutil, importlib
packages = "pybullet", "scipy", "trimesh", "lxml", "viser", "websockets", "paho"
for name in (*packages, "prometheus_client"):
    sys.modules[name] = None
"""
IMPORT_ALL = """
package = importlib.import_module(sys.argv[1])
with_extra = ("zensim.spawner.page", "zensim.deploy.robot_trial")
for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
    if not module.name.startswith(with_extra) and not module.name.endswith("__main__"):
        importlib.import_module(module.name)
"""
CALL_ZENSIM = """
from zensim.deploy.cli import main
sys.argv = ["zensim", *sys.argv[1:]]
main()
"""


def run(code: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", WITHOUT_EXTRAS + code, *arguments],
        cwd=ROOT,
        check=False,
        capture_output=True,
        text=True,
        timeout=120,
    )


@pytest.mark.parametrize(
    "package", ["zensim.proto", "zensim.robot_agent", "zensim.spawner", "zensim.deploy"]
)
def test_package_imports_when_no_extra_is_installed(package: str) -> None:
    done = run(IMPORT_ALL, package)

    assert done.stderr == ""
    assert done.returncode == 0


def test_help_is_shown_when_no_extra_is_installed() -> None:
    done = run(CALL_ZENSIM, "--help")

    assert done.stderr == ""
    assert "serve" in done.stdout


@pytest.mark.parametrize(
    ("command", "extra"),
    [
        (("serve", "--listen", "tcp/127.0.0.1:0"), "server"),
        (("model", "box_bot"), "server"),
        (("check", "README.md"), "server"),
        (("test", "first_minutes"), "server"),
        (("view",), "viewer"),
        (("foxglove",), "foxglove"),
        (("vda5050",), "vda5050"),
        (("record", "--all", "--metrics", "9464"), "metrics"),
    ],
)
def test_command_names_the_extra_when_it_is_not_installed(
    command: tuple[str, ...], extra: str
) -> None:
    done = run(CALL_ZENSIM, *command)

    assert len(done.stderr.splitlines()) == 1
    assert f"pip install 'zensim[{extra}]'" in done.stderr
    assert done.returncode != 0


def test_world_in_process_names_the_extra_when_it_is_not_installed() -> None:
    done = run("import zensim\nzensim.World()")

    assert "pip install 'zensim[server]'" in done.stderr.splitlines()[-1]


def test_server_without_pybullet_names_the_extra_when_it_is_asked_for() -> None:
    code = f"import sys\nsys.modules['pybullet'] = None\n{CALL_ZENSIM}"
    command = ("serve", "--listen", "tcp/127.0.0.1:0", "--engine", "pybullet")

    done = subprocess.run(
        [sys.executable, "-c", code, *command],
        cwd=ROOT,
        check=False,
        capture_output=True,
        text=True,
        timeout=120,
    )

    assert len(done.stderr.splitlines()) == 1
    assert "engine.missing: " in done.stderr
    assert "pip install 'zensim[server]'" in done.stderr
    assert done.returncode == ExitCode.USAGE
