"""Logs of dynos and loggers, a module for each format: a table whose rows share a time, or channels with their own."""
