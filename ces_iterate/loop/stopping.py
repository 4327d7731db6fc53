"""The rules that end an iteration."""

from __future__ import annotations

from collections.abc import Sequence

from ces_iterate.loop.store import Iteration
from ces_iterate.plan.plan import REPEATED, Plan


def find_stop(plan: Plan, history: Sequence[Iteration], next_s: float) -> str:
    """Return which rule of the plan says stop before an experiment of `next_s` seconds; nothing if none does."""
    stop = plan.stop
    newest = history[-1] if history else None
    if newest is not None and newest.fresh_high_J is not None and newest.fresh_high_J <= stop.target_J:
        cost = f"J {newest.fresh_J:.2f} %, with 95 % confidence at most {newest.fresh_high_J:.2f} %"
        return f"target reached: {cost}, on the newest recording before it was used"
    tried = sum(one.number > 0 for one in history)
    if tried >= stop.max_iterations:
        return f"{tried} iterations, the most that the plan allows"
    if plan.experiments.kind == REPEATED and has_stopped_falling(history, stop.fall):
        return f"the cost has stopped falling (by less than {100.0 * stop.fall:.2g} %)"
    spent = history[-1].total_s if history else 0.0
    if spent + next_s > stop.budget_s * (1.0 + 1e-9):
        return f"budget spent: {spent:.1f} of {stop.budget_s:g} s recorded, the next experiment takes {next_s:.1f} s"
    return ""


def has_stopped_falling(history: Sequence[Iteration], fall: float) -> bool:
    """Return whether the newest cost on a fresh repetition is not below the best before by the share `fall`."""
    costs = [one.fresh_J for one in history if one.fresh_J is not None]
    return len(costs) > 1 and costs[-1] > (1.0 - fall) * min(costs[:-1])
