"""A plan with every key explained, as `ces iterate --template` prints it."""

TEMPLATE = """\
# Plan for `ces iterate PLAN.yaml`: designs experiments inside these limits, has them run, and identifies a model.

limits:                   # no experiment leaves them
  stroke_m: 0.025         # [m] to either side of centre_m
  centre_m: 0.0           # [m] position around which the damper is moved, on the rig's own scale
  speed_m_s: 1.0          # [m/s]
  acceleration_m_s2: 90   # [m/s2]
  frequency_Hz: 15        # highest frequency that the actuator follows
  low_A: 0.29             # [A] working range of the current
  high_A: 0.70
  hold_s: 0.03            # [s] shortest time between two steps of the current
  heat:
    power_W: 0            # [W] dissipated power that the damper stands, averaged over memory_s; 0: no limit
    memory_s: 120         # [s] time constant with which the damper cools
    force_N: 1500         # [N] RMS force to expect, until there is a model

rig:
  kind: virtual           # virtual (synthetic data), ros or folder
  # damper: damper.yaml   # virtual: a damper or experiment file of any kind; left out: the packaged damper

  # kind: folder          # an operator runs DIR/commands.csv and puts the dyno's log, or a bag, beside it
  # mapping: my_dyno.yaml # how `ces import` reads the log
  # poll_s: 1.0           # [s] between two looks

  # kind: ros             # a rig behind topics; ROS 2 must be sourced
  # stroke_topic: stroke_command      # std_msgs/Float64 [m]
  # current_topic: valve_command      # std_msgs/Float64 [A]
  # signals: signals.yaml             # topics of position, current and force; left out: the packaged file
  # rate_hz: 500                      # set points per second
  # safe_current_A: 0.4               # before, after, and when anything goes wrong
  # deviation_m: 0.01                 # [m] distance from the set point at which the run is broken off

experiments:
  kind: designed          # designed: each anew; repeated: always the same, the parameters improve in between
  duration_s: 15          # [s] of each
  # commands: mine.csv    # repeated: this experiment (time_s,stroke_m,current_A every 1 ms); left out: a designed one

stop:                     # the first that applies ends the iteration
  budget_s: 60            # [s] recorded in all
  target_J: 0             # [%] cost on the newest recording before it is used for a fit; 0: none
  max_iterations: 20
  fall: 0.02              # repeated: ends when the cost falls by less than this share

identify:                 # as the options of `ces identify`
  structure: polynomial   # polynomial, sigmoid, anfis, relaxation, chambers or auto
  time_s: 60
  starts: 4
  terms: 25
  threads: 2

seed: 1
recordings: []            # bags that exist already: identified first, their seconds do not count
validate: []              # bags that are only judged, and never used for a fit
"""
