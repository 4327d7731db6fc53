"""Waveforms of experiments: strokes and currents over time, from descriptions that files hold."""
