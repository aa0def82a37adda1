"""Settings of operation: journal, inputs, health and metrics of a program."""

from pathlib import Path
from typing import Annotated, Final

import msgspec

from zensim.proto.metrics_address import check_metrics_exposure
from zensim.proto.settings.setting import Setting


class MetricsSettings(msgspec.Struct, frozen=True, kw_only=True):
    """Where a program serves its health and metrics."""

    metrics: Annotated[
        str,
        Setting(
            help="Serve /livez, /readyz and /metrics by http here; without a host on 127.0.0.1.",
            panel="Operation",
            metavar="[HOST:]PORT",
            usual="not served",
        ),
    ] = ""
    metrics_insecure: Annotated[
        bool,
        Setting(
            help="Serve `metrics` to other hosts, too, without TLS or a token.", panel="Operation"
        ),
    ] = False

    def choose_metrics(self, command: str, *, is_insecure: bool = False) -> str:
        """Return where they are served; empty = not at all.

        Args:
            command: To type, with its verb.
            is_insecure: Whether the program serves every client anyway.

        Raises:
            Exposed: Other hosts could read them, and no setting permits it.
            UnusableMetrics: The address is not valid.
        """
        check_metrics_exposure(
            command, self.metrics, is_insecure=self.metrics_insecure or is_insecure
        )
        return self.metrics


USUAL_METRICS: Final = MetricsSettings()
"""Health and metrics are not served."""


class OperationSettings(MetricsSettings, frozen=True, kw_only=True):
    """What a server keeps, and how it is watched."""

    journal: Annotated[
        Path | None,
        Setting(
            help="Record changes in this folder, and restore the world that it contains.",
            metavar="FOLDER",
            usual="no journal",
            variables=("ZENSIM_JOURNAL",),
            key="network.journal",
        ),
    ] = None
    input_log: Annotated[
        bool, Setting(help="Keep all inputs from the start for 'zensim record' and 'resim'.")
    ] = False
