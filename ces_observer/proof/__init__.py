"""Proofs of stability: interval arithmetic, bounds over boxes of inputs, and what a certificate says."""
