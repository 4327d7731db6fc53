"""The registry of model structures that can be identified, and how to choose among them."""

from ces_identify.structures.registry import KITS, model_table, run_batch

__all__ = ["KITS", "model_table", "run_batch"]
