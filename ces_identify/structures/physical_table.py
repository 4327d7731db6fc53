"""The report's table of a model with physics inside: what an engineer knows a damper by."""

from __future__ import annotations

from collections.abc import Sequence

from markupsafe import Markup

from ces_identify.typesetting import ModelTable, four_figures, parameter_table
from ces_observer.model import Model
from ces_observer.structures.chambers import Chambers
from ces_observer.structures.relaxation import Relaxation

CURRENTS = 4
SHARES = (-1.0, -0.5, -0.2, 0.2, 0.5, 1.0)  # of the envelope's speed
ABOUT = "Physical parameters, then the steady force at mid-stroke of full strokes at constant speeds and currents."


def physical_table(body: Relaxation | Chambers, model: Model, named: Sequence[tuple[str, float]]) -> ModelTable:
    """Return named values, the valve's dynamics, and the steady force-speed curves at several currents [N]."""
    low, high = model.envelope.current_A
    currents = [low + (high - low) * n / (CURRENTS - 1) for n in range(CURRENTS)]
    path, side = body.valve, body.side
    values = [
        *named,
        ("Valve lag, rising [ms]", 1e3 * path.rise_s),
        ("Valve lag, falling [ms]", 1e3 * path.fall_s),
        ("Valve dead time [ms]", 1e3 * path.delay_ticks / model.sampling.rate_Hz),
        ("Half width of the magnetic loop [A]", path.hysteresis_A),
        ("Moving mass [kg]", side.mass_kg),
        ("Viscous friction [N s/m]", side.viscous_Ns_m),
    ]
    blank = (Markup(""),) * (CURRENTS - 1)
    rows = [(Markup("{}").format(name), four_figures(value), *blank) for name, value in values]
    slowest, fastest = model.envelope.speed_m_s
    for share in SHARES:
        speed = abs(share) * (fastest if share > 0.0 else slowest)
        forces = (four_figures(body.steady_force(model.operating_range, speed, current)) for current in currents)
        rows.append((Markup("Steady force [N] at {} m/s").format(four_figures(speed)), *forces))
    heads = (
        "Quantity",
        *(f"{current:.3g} A" if n else f"Value, or at {current:.3g} A" for n, current in enumerate(currents)),
    )
    return parameter_table(ABOUT, tuple(map(Markup, heads)), tuple(rows))
