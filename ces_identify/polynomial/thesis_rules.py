"""The candidates of the thesis' procedure, from the rules and the published regressors of its section 5.2.1."""

THESIS_RULES = """\
# Candidates of the thesis (section 5.2.1): u1 current, u2 |speed|, u3 sign of the speed, y past force. Delays 0 to 3,
# powers of the speed 0.2 to 1.2; past forces one or two ticks ago, to the power 1, at most one in a term. In all of its
# published regressors the speed occurs, its sign at a delay of its own, and the current has the power 1.
# The thesis does not name its initial model: this one is viscous.
initial:
  - [{signal: speed}]
force:
  lags: [1, 2]
current:
  lags: [0, 1, 2, 3]
  forms: [magnitude]
speed:
  lags: [0, 1, 2, 3]
  powers: [0.2, 0.4, 0.6, 0.8, 1.0, 1.2]
  forms: [magnitude]
  again: {lags: [0, 1, 2, 3], powers: [0], forms: [signed]}
products:
  - []
  - [current]
  - [speed]
  - [speed, speed]
  - [current, speed]
  - [current, speed, speed]
  - [force]
  - [force, current]
  - [force, speed]
  - [force, speed, speed]
  - [force, current, speed]
  - [force, current, speed, speed]
"""
