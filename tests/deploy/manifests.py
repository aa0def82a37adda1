"""The manifests of Kubernetes, as kustomize renders them."""

import shutil
import subprocess
from functools import cache
from typing import Any

import yaml

from tests.contract.repository import ROOT

FOLDER = ROOT / "deploy" / "kubernetes"
KUSTOMIZE = "sigs.k8s.io/kustomize/kustomize/v5@v5.5.0"
POD_OWNERS = ("Deployment", "StatefulSet")
PODS = (
    *("pool-office", "pool-warehouse", "router", "sensors-office", "sensors-warehouse"),
    *("server-office", "server-warehouse"),
)
"""Names of their owners, known without a program that renders them."""

Manifest = dict[str, Any]


def render(folder: str) -> str:
    """Render a kustomization by kubectl, or by kustomize itself where there is no kubectl."""
    if kubectl := shutil.which("kubectl"):
        command = [kubectl, "kustomize", folder]
    else:
        assert shutil.which("go"), "kubectl and go are missing; install one of them, then try again"
        command = ["go", "run", KUSTOMIZE, "build", folder]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr  # go names there what it downloads
    return done.stdout


@cache
def list_rendered() -> tuple[Manifest, ...]:
    """List the manifests of the router and of both worlds."""
    return tuple(yaml.safe_load_all(render(str(FOLDER))))


def list_of_kind(*kinds: str) -> list[Manifest]:
    """List the manifests of some kinds."""
    return [one for one in list_rendered() if one["kind"] in kinds]


def find_pod(owner: Manifest) -> Manifest:
    """Find the template of the pods of a Deployment or StatefulSet."""
    template: Manifest = owner["spec"]["template"]
    return template


def list_pods() -> dict[str, Manifest]:
    """List the templates of all pods, by the names of their owners."""
    return {one["metadata"]["name"]: find_pod(one) for one in list_of_kind(*POD_OWNERS)}
