"""The controller node's parameters as a table."""

from __future__ import annotations

from functools import partial

from ces_observer.control.control_loop import FEEDBACKS
from ces_observer.nodes.parameter_table import ALLOW_UNCERTIFIED, EXECUTOR, MODEL_TOPIC, ParameterSpec

tunable = partial(ParameterSpec, live=True)
MAX_CURRENT_A = 100.0
FROM_THE_MODEL = -1.0
SPEEDS, FORCES = "curve.speeds_m_s", "curve.forces_N"
CURVE = (
    tunable(SPEEDS, [-1.0, -0.6, -0.3, -0.1, 0.0, 0.1, 0.3, 0.6, 1.0], "desired curve: rising speeds [m/s]"),
    tunable(
        FORCES,
        [-2900.0, -2300.0, -1500.0, -700.0, 0.0, 380.0, 750.0, 1100.0, 1500.0],
        "desired curve: the force at each speed [N], with the sign of the speed",
    ),
)
FIXED = (
    EXECUTOR,
    tunable(
        "model",
        "",
        "path of the model file (model.json) that the observer uses, too; its inverse is fed forward. If it is changed "
        "while running, the new model is checked and adopted",
    ),
    MODEL_TOPIC,
    ALLOW_UNCERTIFIED,
    ParameterSpec("estimate_topic", "observer/estimate", "topic of the estimates (JointState: velocity, effort)"),
    ParameterSpec("joint", "", "joint of the estimates to control; empty: the first in the message"),
    ParameterSpec("force_topic", "measured_force", "topic of the measured force (WrenchStamped: wrench.force.z)"),
)
LOOP = (
    tunable("feedback", "estimate", "which force is fed back", one_of=FEEDBACKS),
    tunable(
        "max_age_s",
        0.05,
        "largest difference between an estimate's stamp and the clock at which the estimate is used [s]; 0: any",
        lowest=0.0,
        highest=3600.0,
    ),
)
TUNING = (
    tunable("low_A", 0.29, "lowest current to command [A]", 0.0, MAX_CURRENT_A),
    tunable("high_A", 0.70, "highest current to command [A]", 0.0, MAX_CURRENT_A),
    tunable("safe_A", 0.40, "current without a usable estimate [A], within the limits", 0.0, MAX_CURRENT_A),
    tunable("rate_A_s", 100.0, "fastest change of the command [A/s]", 0.01, 1e6),
    tunable("timeout_s", 0.05, "time without estimates after which the safe current is commanded [s]", 0.005, 10.0),
    tunable("loop_gain_1_s", 4.0, "gain of the feedback [1/s]; 0: feed-forward alone", 0.0, 100.0),
    tunable("settle_m", 0.003, "stroke after a reversal from which the force is fed back [m]", 0.0, 1.0),
    tunable(
        "valve_lag_s",
        FROM_THE_MODEL,
        "lag of the force behind the current that the command's lead compensates [s]; 0: no lead; negative: the "
        "model's lag minus preview_s",
        lowest=FROM_THE_MODEL,
        highest=0.2,
    ),
    tunable("preview_s", 0.006, "time by which the feed-forward predicts the speed [s]", 0.0, 0.05),
    tunable("lead_filter_s", 0.003, "time constant of the filters of lead and preview [s]", 0.0, 0.1),
    tunable("recovery_s", 0.2, "time of fading in after an interruption [s]", 0.0, 60.0),
)
ALL = (*FIXED, *LOOP, *TUNING, *CURVE)
