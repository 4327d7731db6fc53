"""The report of an iteration: one HTML page with cost, coverage and every experiment."""
