"""Processes that are forked after a Zenoh session, whose threads they do not have."""

import subprocess
import sys

import pytest

WITHIN_S = 60.0
PROGRAM = """
import os, sys
import zensim
from zensim.deploy.cli import main
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_session import open_bus

def connect(endpoint):
    zensim.connect(endpoint, timeout_s=5.0)

def launch(_):
    zensim.launch(timeout_s=20.0)

def servers(endpoint):
    zensim.servers(endpoint)

def command(endpoint):
    sys.argv = ["zensim", "list", "--connect", endpoint]
    try:
        main()
    except SystemExit as ended:
        print("status", ended.code, flush=True)
        os._exit(3)

session = open_bus(BusConfig(mode="router", listen=("tcp/127.0.0.1:0",)))
endpoint = session.endpoint
if sys.argv[2] == "closed":
    session.close()
child = os.fork()
if not child:
    try:
        globals()[sys.argv[1]](endpoint)
    except zensim.Error as error:
        print(error.slug, "spawn" in error.hint, flush=True)
        os._exit(3)
    os._exit(0)
_, status = os.waitpid(child, 0)
print("child", os.waitstatus_to_exitcode(status))
"""


@pytest.mark.parametrize("parent", ["open", "closed"])
@pytest.mark.parametrize("what", ["connect", "launch", "servers", "command"])
def test_forked_process_is_told_at_once_to_be_spawned(what: str, parent: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, what, parent],
        capture_output=True,
        text=True,
        timeout=WITHIN_S,
        check=True,
    )

    assert done.stdout.split()[-2:] == ["child", "3"]
    if what == "command":
        assert "status 1" in done.stdout
        assert "spawn" in done.stderr
    else:
        assert "forked True" in done.stdout


def test_process_that_is_forked_before_any_session_opens_one() -> None:
    program = PROGRAM.replace(
        "session = open_bus", "if os.fork():\n    os.wait()\n    os._exit(0)\nsession = open_bus"
    )
    program = program.partition("child = os.fork()")[0] + "print('opened', flush=True)\n"
    done = subprocess.run(
        [sys.executable, "-c", program, "connect", "closed"],
        capture_output=True,
        text=True,
        timeout=WITHIN_S,
        check=True,
    )
    assert done.stdout.split() == ["opened"]
