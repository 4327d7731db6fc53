"""The damper-maker's characteristics of recordings: force over speed, loops, work, hysteresis, response of the valve.

Read in this order: `motion` (one uniform grid, speed without delay), `cycles` (which cycles repeat at a constant
current), `conditions` (cycles of one current, amplitude and frequency), `cycle_values` (what one cycle says), `knee`,
`steps` (steps of the current), `speed_bins` (any motion), `rows` (the tables), `omissions` (what is missing, and why),
`characterise` (all of it), `page`.
"""
