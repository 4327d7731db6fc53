"""Mount compliance: a rubber bushing or rod end in series takes part of the stroke, equally in both directions."""

from __future__ import annotations

from collections.abc import Sequence

from ces_gap.effects.effect import MOTION, Effect, TwinRun, stiffness


class MountCompliance(Effect):
    name, stage = "mount_compliance", MOTION
    needs = "motion fast enough to change the force within tens of milliseconds"
    summary = "elastic bushings"
    visible, mistaken_for = "as force builds up, equally in both directions", ("compressibility", "position_delay")
    bench = ("continuous", "width_N")


class SeriesMount(MountCompliance):
    """The simulation's twin behind a spring: its equations are solved with the spring in one step.

    Source: Dixon 2007, on bushings. Rubber has 1e5 to 1e7 N/m, rod ends are stiffer.
    """

    form, edits = "series", True
    parameters = (stiffness("stiffness_N_m", 5e4, 1e9, (3e5, 2e6, 1e7), "stiffness of the bushing"),)

    def edit(self, run: TwinRun, values: Sequence[float]) -> TwinRun:
        return run.soften(1.0 / values[0])
