"""Checks: recordings that can be read, but that would make a wrong model or a wrong figure.

Recordings in; findings with a remedy out, one line each. A check that cannot know says nothing.
"""
