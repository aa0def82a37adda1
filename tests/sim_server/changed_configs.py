"""Configurations of servers with changed settings, which nothing has checked yet."""

from msgspec.structs import replace

from zensim.sim_server.server_config import ServerConfig


def with_settings(config: ServerConfig, **changes: object) -> ServerConfig:
    """Change fields of a configuration, or settings by name."""
    settings = config.settings
    for group in settings.__struct_fields__:
        before = getattr(settings, group)
        own = {name: changes.pop(name) for name in before.__struct_fields__ if name in changes}
        settings = replace(settings, **{group: replace(before, **own)})
    return replace(config, settings=settings, **changes)
