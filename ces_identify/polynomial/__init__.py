"""Polynomial NARX models: candidate rules and series in, selected terms with fitted coefficients out."""
