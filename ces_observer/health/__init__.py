"""The health of a running observer: samples, estimates and reasons in, values for /diagnostics out."""
