"""Recordings as they were logged: bags and dyno logs go in, a `Recording` with channels and their stamps comes out.

Nothing is mended here: `checks`, `consistency` and `coverage` say what cannot be used and what is missing.
"""
