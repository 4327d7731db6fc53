"""The damper-maker's characteristics of recordings: force over speed, loops, work, hysteresis, response of the valve.

Read in this order: `motion` (one uniform grid, speed without delay), `cycles` (which cycles repeat at a constant
current, what each says), `steps` (steps of the current), `rows` (the columns of every table, and what is missing),
`characterise` (cycles of one current, amplitude and frequency, and their tables; force over speed of any motion),
`page` (what people see).
"""
