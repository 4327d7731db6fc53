"""The resident memory of a process over time, its slope after the first minute, and a plot of it."""

from __future__ import annotations

import threading
import time
from pathlib import Path

SETTLED_S = 60.0
MAX_GROWTH_KB = 1024.0  # from the first minute to the end, by the slope


class Memory:
    """Samples VmRSS once a second in its own thread until `stop`; `kB` by `seconds` since the beginning."""

    def __init__(self, pid: int) -> None:
        self._status = Path(f"/proc/{pid}/status")
        self._stopped = threading.Event()
        self.seconds: list[float] = []
        self.kB: list[int] = []
        self._thread = threading.Thread(target=self._sample)
        self._thread.start()

    def stop(self) -> None:
        self._stopped.set()
        self._thread.join()

    def growth_kB(self) -> float | None:
        """Return the rise of a straight line fitted after the first minute; None if the run is too short."""
        pairs = [(s, kB) for s, kB in zip(self.seconds, self.kB, strict=True) if s >= SETTLED_S]
        if len(pairs) < SETTLED_S:
            return None
        mean_s, mean_kB = (sum(values) / len(pairs) for values in zip(*pairs, strict=True))
        slope = sum((s - mean_s) * (kB - mean_kB) for s, kB in pairs) / sum((s - mean_s) ** 2 for s, _ in pairs)
        return slope * (pairs[-1][0] - pairs[0][0])

    def plot(self, path: Path) -> None:
        """Plot the memory [MB] over time [min]."""
        import matplotlib as mpl

        mpl.use("Agg")
        from matplotlib import pyplot as plt

        figure, axes = plt.subplots(figsize=(7.0, 2.6), layout="constrained")
        axes.axvspan(0.0, SETTLED_S / 60.0, color="0.93", lw=0.0, label="first minute")
        axes.plot([s / 60.0 for s in self.seconds], [kB / 1024.0 for kB in self.kB], color="C0", lw=1.5)
        axes.set(xlabel="time [min]", ylabel="resident memory [MB]", ylim=(0.0, 1.25 * max(self.kB) / 1024.0))
        axes.set_xlim(0.0, self.seconds[-1] / 60.0)
        axes.legend(frameon=False, loc="lower right")
        axes.spines[["top", "right"]].set_visible(False)
        figure.savefig(path, dpi=150)
        plt.close(figure)

    def _sample(self) -> None:
        began = time.monotonic()
        while not self._stopped.wait(1.0 - (time.monotonic() - began) % 1.0):
            try:
                lines = self._status.read_text(encoding="utf-8").splitlines()
            except OSError:
                return
            resident = next((line for line in lines if line.startswith("VmRSS")), None)
            if resident is None:  # a zombie has none
                return
            self.seconds.append(time.monotonic() - began)
            self.kB.append(int(resident.split()[1]))
