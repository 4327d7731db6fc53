"""The gap between a simulation and recordings of the real damper: where it lies, which effect causes it, what helps.

The rooms in reading order: `trace` (recording and simulation on one grid), `effects` (the physics that a simulation may
lack), `baseline` (what the simulation gets wrong without any effect), `intake` (checked inputs), `inference` (which
effects, how sure), `where` (in which stroke, speed, current ...), `experiment` (what to record next), `augmented` (the
repaired simulation as a file), `report` (page and gap.json), `fleet` (many diagnoses). `diagnose` runs them in turn.
"""
