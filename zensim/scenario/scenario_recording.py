"""The recording of a run, as the section `record` of its scenario says."""

from pathlib import Path

from zensim.api.api_errors import Error
from zensim.api.simulation import Simulation
from zensim.recording.recording_parts import remove_recording
from zensim.scenario.scenario_reader import Scenario


def find_recording(scenario: Scenario) -> Path | None:
    """Find where a run is recorded; None if it is not."""
    section = scenario.format.record
    if section is None:
        return None
    name = scenario.name.replace("/", "_")
    return scenario.find_file("record.to", section.to.format(name=name, seed=scenario.seed))


class ScenarioRecording:
    """Records a run from its first spawn to its end."""

    def __init__(self, scenario: Scenario, sim: Simulation, path: Path) -> None:
        """Begin; the recording of an earlier run at this path is replaced.

        Raises:
            Error: It cannot be recorded.
        """
        section = scenario.format.record
        assert section is not None
        self._path = path
        self._keeps_always = section.keep == "always"
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            remove_recording(path)
        except OSError as error:
            reason = error.strerror or str(error)
            raise Error(f"'{path}' cannot be recorded: {reason}", slug="no_recorder") from error
        self._recorder = sim.record(path, *section.topics)
        self._is_over = False
        self.failure = ""
        """Why it has not been recorded to its end."""
        self.kept = ""
        """File or folder of the recording, when it is over and was kept."""

    def end(self, *, is_passed: bool) -> None:
        """End it, and remove it if only failures are kept; may be repeated."""
        if self._is_over:
            return
        self._is_over = True
        try:
            self._recorder.close()
        except Error as error:
            self.failure = str(error)
        if self._keeps_always or not is_passed or self.failure:
            self.kept = str(self._path)
        else:
            remove_recording(self._path)
