"""Recordings as they were logged: bags and dyno logs in, a `Recording` with channels and their stamps out.

Nothing is repaired here: `checks`, `consistency` and `coverage` report what is unusable or missing.
"""
