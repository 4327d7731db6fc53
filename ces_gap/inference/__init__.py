"""Which effects explain the gap: evidence goes in, fitted compositions, alternatives and a verdict come out.

Candidates are compared on parts of the evidence that were left out of their fit.
"""
