"""Proofs of stability: interval arithmetic, and the certificate that a model is a contraction over its envelope."""
