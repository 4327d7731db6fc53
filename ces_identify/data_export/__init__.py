"""Recordings as tables for other programs: columns in SI units, on one time or as logged, as CSV or Parquet."""
