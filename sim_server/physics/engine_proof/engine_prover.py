"""Chooses an engine that has passed its cases; runs them once for each build of an engine."""

import logging
import time
from contextlib import suppress
from functools import cache
from importlib import import_module

from zensim.proto.engine_proofs import (
    CaseResult,
    EngineName,
    EngineProof,
    find_engine_build,
    read_proof,
    write_proof,
)
from zensim.proto.settings.engine_settings import EngineChoice
from zensim.sim_server.physics.engine_config import (
    EngineUnusable,
    choose_engine,
    find_installed_engines,
)

LOG = logging.getLogger(__name__)
TRIALS: dict[EngineName, tuple[str, str]] = {
    "pybullet": ("zensim.sim_server.physics.engine_proof.bullet_trials", "BulletTrials"),
    "mujoco": ("zensim.sim_server.physics.engine_proof.mujoco_trials", "MujocoTrials"),
}
UPGRADES: dict[EngineName, str] = {
    "pybullet": "pip install --force-reinstall 'zensim[server]'",
    "mujoco": "pip uninstall mujoco mujoco-core, then pip install 'zensim[server]' "
    "(docs/upgrade.md)",
}
"""Packages of MuJoCo share a folder: what is left of one breaks the next."""


class EngineFailed(EngineUnusable):
    """An engine computes wrongly, or cannot be loaded."""

    slug = "engine.failed"


def choose_proven_engine(choice: EngineChoice) -> EngineName:
    """Choose an installed engine, and have it prove itself if this build of it has not yet.

    Raises:
        EngineMissing: The chosen one is not installed, or none is.
        EngineFailed: It fails a case, and this is not allowed.
    """
    installed = find_installed_engines()
    name = choose_engine(choice, installed)
    proof = prove_engine(name)
    if proof.failed is None:
        return name
    line = f"{name} {proof.build.version} fails a case: {proof.failed.describe()}"
    if choice.allow_failed_engine:
        LOG.warning("%s; it is used all the same", line)
        return name
    others = [f"use `engine` {other}, " for other in installed if other != name]
    raise EngineFailed(
        f"{EngineFailed.slug}: {line}; {UPGRADES[name]}, {''.join(others)}"
        "or use `allow_failed_engine`"
    )


@cache
def prove_engine(name: EngineName) -> EngineProof:
    """Read the proof of an engine, or make and keep it; once in a process.

    A failed proof is made again at the next start, as what failed may not be the library.
    """
    build = find_engine_build(name)
    proof = read_proof(build)
    if proof is None or proof.failed is not None:
        proof = EngineProof(build, _run_cases(*TRIALS[name]), time.time())
        with suppress(OSError, RuntimeError):  # each start proves it where nothing can be kept
            write_proof(proof)
        LOG.info("engine=%s version=%s cases=%d", name, build.version, len(proof.cases))
    return proof


def _run_cases(module: str, class_name: str) -> tuple[CaseResult, ...]:
    try:
        made = getattr(import_module(module), class_name)()
    except (ImportError, AttributeError, OSError) as error:
        fault = f"{type(error).__name__}: {error}"
        return (CaseResult("loading", "", None, 0.0, 0.0, fault),)
    # Imported here, as most starts find a proof.
    from zensim.sim_server.physics.engine_proof.closed_form_cases import CASES  # noqa: PLC0415

    return tuple(case.run(made) for case in CASES)
