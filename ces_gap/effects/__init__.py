"""Effects as physics: a trace and parameter values go in, changed inputs of the simulation or a changed force come out.

`effect` is the base class, `library` holds the effects, one module each; the other modules are physics they share.
"""
