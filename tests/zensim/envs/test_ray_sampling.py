"""Tasks of Ray sample worlds with the hashes of one process."""

import os
import subprocess
import sys

import pytest

from tests.contract.repository import ROOT
from zensim.deploy.sweep.ray_cluster import local_cluster, protect_local_cluster

EXAMPLE = ROOT / "examples" / "learning" / "sample_on_ray.py"


def test_worlds_on_ray_have_the_hashes_of_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("RAY_ADDRESS", "RAY_AUTH_MODE", "RAY_AUTH_TOKEN"):
        monkeypatch.delenv(name, raising=False)
    protect_local_cluster()

    with local_cluster(2) as address:
        done = subprocess.run(
            [sys.executable, str(EXAMPLE), "--tasks", "3"],
            env={**os.environ, "RAY_ADDRESS": address},
            capture_output=True,
            text=True,
            timeout=250,
            check=False,
        )

    lines = [line.split() for line in done.stdout.splitlines() if line.startswith("seed=")]
    assert [line[0] for line in lines] == ["seed=0", "seed=1", "seed=2"], done.stderr
    assert {line[2] for line in lines} == {"is_same=True"}
    assert len({line[1] for line in lines}) == 3
