"""The public names of `zensim`, each with the module that is imported when it is first used."""

from importlib import import_module

MODULES: dict[str, tuple[str, ...]] = {
    "zensim.api.api_errors": (
        "Closed",
        "ConnectionLost",
        "Denied",
        "Error",
        "Invalid",
        "NotFound",
        "SpawnRefused",
        "SteppedElsewhere",
        "Timeout",
        "Unreachable",
        "Unsupported",
    ),
    "zensim.api.connections": ("connect", "launch", "servers"),
    "zensim.api.entity_values": ("RobotPose", "RobotTwist", "SpawnReport", "deg"),
    "zensim.api.fleet": ("Fleet",),
    "zensim.api.in_process_world": ("World",),
    "zensim.api.odometry_table": ("FleetOdometryRows",),
    "zensim.api.recording_file": ("Recording",),
    "zensim.api.robot": ("EntityHandle", "Robot"),
    "zensim.api.sim": ("Sim",),
    "zensim.api.simulation": ("Simulation",),
    "zensim.api.topic": ("Topic", "TopicCallback"),
    "zensim.api.world_page": ("WorldPage",),
    "zensim.api.world_picture": ("WorldPicture",),
    "zensim.api.world_view": ("WorldView",),
    "zensim.scenario.scenario_loading": ("load",),
    "zensim.scenario.world_export": ("export",),
}
"""Names by module."""
_MODULE_OF = {name: module for module, names in MODULES.items() for name in names}


def find_public_name(name: str) -> object:
    """Import what a public name stands for.

    Raises:
        AttributeError: It is no public name.
        ModuleNotFoundError: It needs a package of the extra `server`, which is not installed.
    """
    if name == "__version__":
        return import_module("importlib.metadata").version("zensim")
    if (module := _MODULE_OF.get(name)) is None:
        raise AttributeError(f"module 'zensim' has no attribute {name!r}")
    try:
        return getattr(import_module(module), name)
    except ModuleNotFoundError as error:
        if (error.name or "zensim").startswith("zensim"):
            raise
        raise ModuleNotFoundError(
            f"zensim.{name} needs {error.name}, which is not installed; use "
            "pip install 'zensim[server]'",
            name=error.name,
        ) from error


def list_public_names() -> list[str]:
    """List all public names, sorted."""
    return sorted((*_MODULE_OF, "__version__"))
