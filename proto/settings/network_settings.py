"""Settings of the network: where a server listens, whom it admits, and the name of its world."""

from typing import Annotated, Final

import msgspec

from zensim.proto.endpoints import DEFAULT_ENDPOINT
from zensim.proto.settings.setting import Setting

NAME_PATTERN: Final = r"^[A-Za-z][A-Za-z0-9_]{0,62}$"
"""Names that scenario files may give."""
WAIT_S: Final = 30.0


class NetworkSettings(msgspec.Struct, frozen=True, kw_only=True):
    """The Zenoh network of a server."""

    listen: Annotated[
        str,
        Setting(
            help="Zenoh endpoint to listen on, as a router; port 0 = any free port.",
            panel="Connection",
            metavar="ENDPOINT",
            usual=DEFAULT_ENDPOINT,
            key="network.listen",
        ),
    ] = ""
    connect: Annotated[
        str,
        Setting(
            help="Connect to this Zenoh router instead of listening.",
            panel="Connection",
            metavar="ENDPOINT",
            variables=("ZENSIM_CONNECT",),
            key="network.connect",
        ),
    ] = ""
    secure: Annotated[
        bool,
        Setting(
            help="Admit only users with a join token, over TLS; makes certificates and tokens.",
            panel="Connection",
        ),
    ] = False
    client_certificates: Annotated[
        bool,
        Setting(
            help="With `secure`: ask clients for a certificate, too; tokens are longer.",
            panel="Connection",
        ),
    ] = False
    insecure: Annotated[
        bool,
        Setting(
            help="Admit everybody who reaches the endpoint, also from other hosts.",
            panel="Connection",
        ),
    ] = False
    mesh_http: Annotated[
        str,
        Setting(
            help="Offer meshes of robots by http here, and name them so in descriptions for RViz.",
            panel="Connection",
            metavar="HOST:PORT",
            usual="descriptions name them as given",
        ),
    ] = ""
    wait: Annotated[
        float,
        Setting(
            help="Timeout of connecting to the router.",
            panel="Connection",
            metavar="SECONDS",
            unit="s",
            least=0.0,
            key="network.wait",
        ),
    ] = WAIT_S
    world_name: Annotated[
        str,
        Setting(
            help="Name of the world on the network.",
            panel="Connection",
            metavar="NAME",
            variables=("ZENSIM_WORLD",),
            key="world.name",
            pattern=NAME_PATTERN,
        ),
    ] = "default"
