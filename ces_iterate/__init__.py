"""Experiments on the rig in the loop: designed, run, identified, repeated."""
