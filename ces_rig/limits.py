"""The numbers that decide about rigs and their experiments, each with its unit and where it comes from.

The limits of a user's own rig stand in the plan (`RigLimits`), the settings of a node in its parameters. Settings of a
numerical method and ranges of physical numbers stand where these are.
"""

from __future__ import annotations


class LiveLimits:
    """When a live rig, or one behind ROS 2 topics, is not as it should be."""

    MAX_LAG_S = 0.1  # [s] behind its clock, above which the node warns: a command expires at this age (docs/rig.md)
    MAX_DRIFT_S = 0.01  # [s] between system and steady clock, above which stamps are corrected: ten samples at 1 kHz
    FIND_S = 30.0  # [s] for the rig's topics: discovery in ROS 2 takes seconds, starting a rig by hand some more
    GRACE_S = 0.3  # [s] after the start, until positions are due: discovery of a reader that has just begun
    FOLLOW_S = 0.15  # [s] of set points that a measured stroke may follow: a servo of 15 Hz lags by 10 ms
    SAFE_TIMES = 10  # set points of the safe current at the end: best-effort topics may lose one


class DesignLimits:
    """When an experiment may be run, and when a state counts as known."""

    TOLERANCE = 1e-4  # of a limit, and in A: rounding of the five digits in commands.csv (docs/iterate.md)
    MARGIN = 0.002  # of a limit: differences of samples are a little below the peaks of the spline between them
    START_LOAD = 0.5  # of the heat limit, at which an experiment may begin: the rest is for its own heat
    MIN_LOG_SHARE = 0.9  # of an experiment's length, in a log from a rig: loggers are started and stopped by hand
    KNOWN_VARIANCE = 0.01  # of a state that counts as covered: its force is known to a tenth of what it could be


class MapLimits:
    """When a table of a damper can be learned from a recording."""

    MIN_CURRENTS_A = 0.05  # [A] of its currents: five steps of a 10-bit converter over 10 A
    MIN_EXPLAINED = 0.7  # of the force's variance: J is below 55 %, beyond which signs or delays are wrong
