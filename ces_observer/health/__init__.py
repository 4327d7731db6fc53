"""The health of a running observer: samples, estimates and reasons go in, values for /diagnostics come out."""
