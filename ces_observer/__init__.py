"""What runs on the vehicle: model file, speed bank and estimator (standard library only), and the ROS 2 nodes.

The rooms in reading order: `structures` (what a tick of each kind of model computes) with `proof` (why it is stable),
the model file, the tracker and the estimator at the top, `cdr` (serialised messages), `health` (diagnostics),
`control` (the reference controller), `nodes` (ROS 2). The names below are public.

    estimator = Estimator(load_model("model.json"))
    force_N = estimator.step(stamp_ns, position_m, current_A)  # None while it withholds; estimator.reason says why
"""

from typing import TYPE_CHECKING

from ces_observer.lazy_names import import_on_use

if TYPE_CHECKING:
    from ces_observer.errors import CesError
    from ces_observer.estimator import Estimator
    from ces_observer.model import Model, load_model

__version__ = "0.1.0"
__all__ = ["CesError", "Estimator", "Model", "load_model"]

__getattr__ = import_on_use(
    __name__,
    {
        "ces_observer.errors": ("CesError",),
        "ces_observer.estimator": ("Estimator",),
        "ces_observer.model": ("Model", "load_model"),
    },
)
