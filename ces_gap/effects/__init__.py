"""Effects as physics: a trace and parameter values in, changed inputs of the simulation or a changed force out.

`effect` has the base class, `library` one module for each effect, the other modules the physics that they share.
"""
