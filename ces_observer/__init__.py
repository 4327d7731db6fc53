"""What runs on the vehicle: model file, differentiator and estimator (standard library only), and the ROS 2 nodes.

The rooms in reading order: `structures` (what a tick of each kind of model computes) with `proof` (why it is stable),
the model file, the tracker and the estimator at the top, `cdr` (serialised messages), `health` (diagnostics),
`recorder` (the black box), `control` (the reference controller), `nodes` (ROS 2). The names below are public.

    estimator = Estimator(load_model("model.json"))
    force_N = estimator.step(stamp_ns, position_m, current_A)  # None while it withholds; estimator.reason says why
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ces_observer.errors import CesError
    from ces_observer.estimator import Estimator
    from ces_observer.model import Model, load_model

__version__ = "0.1.0"
__all__ = ["CesError", "Estimator", "Model", "load_model"]

_HOME = {"CesError": "errors", "Estimator": "estimator", "Model": "model", "load_model": "model"}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'ces_observer' has no attribute '{name}'")
    from importlib import import_module

    return getattr(import_module(f"ces_observer.{_HOME[name]}"), name)
