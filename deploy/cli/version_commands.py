"""`zensim version`: versions of zensim, Python, and the libraries that it uses."""

import platform
import sys

from zensim.deploy.cli.command_session import print_json
from zensim.proto.options.command_options import JsonOption
from zensim.proto.options.option_groups import make_app
from zensim.proto.package_versions import find_reported_versions
from zensim.proto.printable_text import print_lines
from zensim.proto.settings.engine_settings import EngineChoice
from zensim.proto.verbosity import CURRENT
from zensim.sim_server.physics.engine_config import explain_default, find_installed_engines

app = make_app()


@app.command("version")
def print_versions(*, as_json: JsonOption = False) -> None:
    """Print the versions of zensim, Python, and the libraries that zensim uses."""
    versions = find_reported_versions()
    versions["python"] = platform.python_version()
    versions["platform"] = f"{sys.platform} {platform.machine()}"
    if as_json:
        print_json(versions)
    elif CURRENT.is_quiet:
        print_lines(versions["zensim"])
    else:
        for name, found in versions.items():
            print_lines(f"{name:<14} {found}")
        if reason := explain_default(EngineChoice(), find_installed_engines()):
            print_lines(reason)
