"""Stability: interval arithmetic and the certificate that a model is a contraction over its whole envelope."""
