"""Physical damper models, one package per kind: stroke and current in, force, coil current and temperature out.

`model` is what all kinds are, `effects` what withheld effects of all kinds have in common, `kinds` the list of kinds.
"""
