"""What every rig can do: run commands and return the recording."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from ces_identify.recordings.recording import Recording
from ces_iterate.commands import Commands


class Rig(Protocol):
    """A rig. A new kind is a module beside this file and an entry in `kinds.RIGS`."""

    def run(self, commands: Commands, folder: Path) -> Recording:
        """Run the commands and return what was recorded: at least position, current and force.

        `folder` is that of the iteration, for files that the rig needs; it exists. An interrupted run may be started
        again in the same folder. Raises CesError if the rig does not do what is asked.
        """
