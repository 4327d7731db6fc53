"""Comparison of models on the same recordings: costs, differences with paired intervals, time a tick, envelopes."""
